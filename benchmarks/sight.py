"""What the insertion task's picture tells: where the blocks stand, read by the default encoder.

Trains the encoder to name the blocks' place along the gap and their yaws in pictures of random
motions, and prints its errors on other episodes: as they are, with the lamp moved, and with the
camera shifted. No reinforcement learning; an encoder that cannot tell would not learn it either.

    python -m benchmarks.sight
"""

from __future__ import annotations

import argparse
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from rrl.encoders import PixelEncoder
from rrl.envs import InsertionPixelsEnv
from rrl.inputs import Input

DISTURBANCES: dict[str, dict[str, Any]] = {
    "as trained": {},
    "lamp moved by 1 m along x and y": {"light_shift": (1.0, 1.0, 0.0)},
    "camera shifted by 2 cm along x": {"camera_shift": (0.02, 0.0, 0.0)},
}
PICTURES, STEPS, DOWN = 10, 2, 0.6
"""Pictures of an episode, control steps between two of them, mean action along -z."""


def seen(episodes: int, seed: int, size: int, **disturbance: Any) -> tuple[Tensor, Tensor]:
    """Return pictures [n, size, size, 3], and what is to be read: y [mm], two yaws [deg], [n, 3]."""
    env = InsertionPixelsEnv(
        num_envs=episodes, num_threads=1, seed=seed, picture_size=size, place_range=(0.0, 0.03),
        **disturbance,
    )  # fmt: skip
    generator = torch.Generator().manual_seed(seed)
    observation, pictures, poses = env.reset(), [], []
    for _ in range(PICTURES):
        blocks = observation["blocks"]
        pictures.append(observation["pixels"])
        place = 1e3 * blocks[:, [1, 6]].mean(1, keepdim=True)
        poses.append(torch.cat([place, blocks[:, [4, 9]].rad2deg()], 1))
        for _ in range(STEPS):
            action = 2 * torch.rand(episodes, 3, generator=generator) - 1
            action[:, 2] = 0.4 * action[:, 2] - DOWN
            observation = env.step(TensorDict({"action": action}, env.batch_size))["next"]
    env.close()
    return torch.cat(pictures), torch.cat(poses)


def trained(pictures: Tensor, poses: Tensor, shift: int, updates: int) -> nn.Module:
    """Return an encoder with a head that reads poses, in units of their spread."""
    torch.manual_seed(0)
    entry = Input(shape=tuple(pictures.shape[1:]), channels="last")
    encoder = PixelEncoder({"pixels": entry}, shift=shift)
    head = nn.Sequential(nn.Linear(encoder.out_features, 128), nn.ReLU(), nn.Linear(128, 3))
    model, wanted = nn.Sequential(encoder, head), poses / poses.std(0)
    optimizer = torch.optim.Adam(model.parameters(), 1e-3)
    for _ in range(updates):
        batch = torch.randint(len(pictures), (64,))
        (moved,) = encoder.augment(pictures[batch])
        loss = (model(moved) - wanted[batch]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return model


def main() -> None:
    """Print a row for every shift of the training images and every disturbance."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=150, help="to train on")
    parser.add_argument("--updates", type=int, default=500, help="of 64 pictures")
    parser.add_argument("--size", type=int, default=64, help="pixels")
    parser.add_argument(
        "--shifts", type=int, nargs="+", default=[4, 0], help="augmentation, pixels"
    )
    options = parser.parse_args()
    torch.set_num_threads(1)
    pictures, poses = seen(options.episodes, 0, options.size)
    others = {name: seen(30, 9999, options.size, **d) for name, d in DISTURBANCES.items()}
    print("| training images moved by | pictures | place along the gap | yaw, left | right |")
    print("|---|---|---|---|---|")
    for shift in options.shifts:
        model = trained(pictures, poses, shift, options.updates)
        for name, (unseen, truth) in others.items():
            with torch.no_grad():
                error = (model(unseen) * poses.std(0) - truth).square().mean(0).sqrt().tolist()
            errors = f"{error[0]:.1f} mm | {error[1]:.1f} deg | {error[2]:.1f} deg"
            print(f"| {shift} pixels | {name} | {errors} |", flush=True)


if __name__ == "__main__":
    main()
