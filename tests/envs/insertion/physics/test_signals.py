from __future__ import annotations

import numpy as np

from rrl.envs import make_config
from rrl.envs.insertion.model.scene import compile_model
from rrl.envs.insertion.physics.signals import SignalLayout

SHAPES = {
    "joint_position": (7,),
    "joint_origin": (7, 3),
    "joint_axis": (7, 3),
    "tool_position": (3,),
    "tool_axes": (3, 3),
    "wrist_force": (3,),
    "wrist_torque": (3,),
    "contact_force": (1,),
    "held_position": (3,),
    "block_position": (2, 3),
    "block_y_axis": (2, 3),
    "block_z_axis": (2, 3),
    "goal_position": (3,),
}


def test_every_number_has_one_name(variant: str) -> None:
    layout = SignalLayout(compile_model(make_config(variant)))
    data = np.arange(2 * layout.size, dtype=float).reshape(2, layout.size)
    views = layout.views(data)
    assert {name: view.shape[1:] for name, view in views.items()} == SHAPES
    assert len(views) == len(SHAPES)
    seen = np.concatenate([views[name].reshape(2, -1) for name in SHAPES], axis=1)
    np.testing.assert_array_equal(np.sort(seen, axis=1), data)


def test_views_do_not_copy() -> None:
    layout = SignalLayout(compile_model(make_config("sim")))
    data = np.zeros((4, layout.size))
    layout.views(data)["block_position"][0, 1] = 5.0
    assert data.sum() == 15.0
