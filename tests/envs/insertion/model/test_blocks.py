from __future__ import annotations

import numpy as np
import pytest
from dm_control import mjcf

from rrl.envs.insertion.model.blocks import HeldBlock, StandingBlock, chamfered_vertices


@pytest.mark.parametrize("side", [-1, 1])
def test_only_the_inner_top_edge_is_cut(side: int) -> None:
    vertices = chamfered_vertices((0.02, 0.03, 0.04), (0.006, 0.009), side)
    assert vertices.shape == (10, 3)
    assert not (np.isclose(vertices[:, 0], side * 0.02) & np.isclose(vertices[:, 2], 0.04)).any()
    assert (np.isclose(vertices[:, 0], -side * 0.02) & np.isclose(vertices[:, 2], 0.04)).any()
    assert vertices[vertices[:, 0] * side > 0.0199, 2].max() == pytest.approx(0.031)


def test_no_cut_is_a_box() -> None:
    assert chamfered_vertices((0.1, 0.2, 0.3), (0.0, 0.0), 1).shape == (8, 3)


def test_standing_block_keeps_its_place_and_mass() -> None:
    half_size = (0.02, 0.03, 0.04)
    block = StandingBlock("block", half_size, (0.006, 0.009), 1, 0.15, 0.3, (1, 0, 0, 1))
    physics = mjcf.Physics.from_mjcf_model(block.mjcf_model)
    model, data = physics.model.ptr, physics.data.ptr
    # The compiler moves a mesh into its inertial frame; its corners must stay where they were.
    corners = data.geom_xpos[0] + model.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T
    np.testing.assert_allclose(corners.min(axis=0), -np.array(half_size), atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), half_size, atol=1e-6)
    assert physics.bind(block.geom).friction[0] == 0.3


def test_held_block_hangs_below_its_frame() -> None:
    block = HeldBlock((0.02, 0.03, 0.05), 0.3, 1.0, (1, 0, 0, 1))
    physics = mjcf.Physics.from_mjcf_model(block.mjcf_model)
    np.testing.assert_allclose(physics.bind(block.body).pos, (0, 0, 0.05))
    np.testing.assert_allclose(physics.bind(block.geom).size, (0.02, 0.03, 0.05))
