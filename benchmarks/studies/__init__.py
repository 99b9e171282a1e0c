"""The figures and tables of Glondu et al. 2014, repeated: one file a figure, run by `fracture-collision bench`.

A study (study.py) names trials, which run in the processes of a cluster (cluster.py), and says how what they found
becomes tables (table.py), pictures and a section of docs/benchmarks.md (page.py). Pictures and sections are made from
the CSV files alone.
"""
