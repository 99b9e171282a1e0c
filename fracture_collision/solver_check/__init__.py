"""A kit that tests contact solvers against closed forms.

Each case (`cases`) is a scene and a judge. The judge reads what a run publishes (`recorded`): poses, contacts, fracture
events, masses. So a solver in this process (`solver_runs`) and a simulator node of any language, recorded in a bag, are
judged by the same code. Cases that read impulses, or change the lists of contacts, need a solver in this process.
"""
