"""The paper's experiments: from a YAML file to runs, statistics, figures and a report.

``spec`` reads the files, ``plan`` turns them into runs, ``store`` keeps them, ``pool`` and ``launchers`` run what is
missing, ``outcomes`` reads them back, ``figures``, ``claims`` and ``report`` show them, ``reproduce`` is the command.
"""
