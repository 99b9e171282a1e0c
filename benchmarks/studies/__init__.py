"""The figures and tables of Glondu et al. 2014, reproduced: one file per figure, run by `fracture-collision bench`.

A study (study.py) defines trials, which run in the processes of a cluster (cluster.py), and how their results become
tables (table.py), pictures and a section of docs/benchmarks.md (page.py). Pictures and sections are made from the CSV
files alone.
"""
