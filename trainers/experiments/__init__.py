"""The paper's experiments: from a YAML file to runs, statistics, figures and a report.

``spec`` reads the files, ``plan`` turns them into jobs of the pool, ``outcomes`` reads the runs
back, ``tables``, ``figures``, ``claims`` and ``report`` show them, ``numbers`` writes them as CSV,
``data`` is what a repository keeps of runs, ``reproduce`` is the command.
"""
