"""Training speed against Stable-Baselines3, SBX, CleanRL's and TorchRL's way of writing TD3: ``make benchmark``."""
