"""Other people's tasks, with the controllers that they ship or simple ones (extra `gallery`).

Nothing in here is needed to use an environment: makers as anybody would write them, for
:func:`rrl.envs.gymnasium_env`, and functions and objects for
:class:`rrl.controllers.FunctionController`.
"""
