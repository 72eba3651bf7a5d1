"""Block push: sizes, what policies see, tasks."""

from beso.data.spec import PlaySpec

SPEC = PlaySpec(
    name="block_push",
    observation_size=16,
    action_size=2,
    visible=tuple(range(10)),  # the poses of the targets are hidden: only the goal tells where the blocks belong
    goal_masked=(2, 5, 6, 7, 8, 9),  # a goal is the places of the two blocks, not their yaw nor the robot
    goal_window=1,
    tasks=("block 1 to target 1", "block 1 to target 2", "block 2 to target 1", "block 2 to target 2"),
    goal_sets=("training", "held_out"),
    packages=("numpy", "pybullet"),
)
LONGEST = 201  # steps of a demonstration that ran into its limit
