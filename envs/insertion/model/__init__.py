"""The MJCF model: arm, gripper, blocks, table, actuators, sensors."""
