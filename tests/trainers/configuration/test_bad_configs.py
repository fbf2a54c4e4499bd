"""Broken configurations: each gives one message that says where, what was expected and what came."""

import pytest
from pydantic import ValidationError

from rrl.envs import InsertionEnv
from rrl.trainers.cli.compose import compose
from rrl.trainers.configuration import build as assembly
from rrl.trainers.errors import message
from rrl.trainers.settings import TrainerSettings

AGENT, BASE = "algorithm.agent", "env.base"

# what is set on the command line -> what the message has to contain
BROKEN = {
    # unknown keys
    "trainer.sede=3": ["trainer.sede: unknown key; did you mean trainer.seed?"],
    "env.base.varient=x": [f"{BASE}.varient", f"did you mean {BASE}.variant?", "+env.base.varient"],
    "env.bse.variant=x": ["env.bse: unknown key; did you mean env.base?"],
    "env.base.nothing=1": ["+env.base.nothing=1"],
    "+trainer.sede=3": ["trainer.sede: unknown key", "3"],
    "+trainer.evaluation.evry=3": ["trainer.evaluation.evry: unknown key"],
    "+trainer.total_step=3": ["trainer.total_step: unknown key", "did you mean total_steps?"],
    "+trainer.gpu=cuda": ["trainer.gpu: unknown key", "cuda"],
    "+render.color=red": ["render.color: unknown key", "red"],
    "+env.inptus.goal={}": ["env.inptus: unknown key"],
    "+speed=fast": ["speed: expected speed=fast to exchange it, got +speed=fast"],
    "++algorithm=sac": ["algorithm: expected algorithm=sac to exchange it", "++algorithm=sac"],
    "+algorithm.agent.learning_rate=0.1": [AGENT, "does not take 'learning_rate'", "actor_lr"],
    "+algorithm.exploration.thetta=0.1": [
        "algorithm.exploration",
        "does not take 'thetta'",
        "theta",
    ],
    "+controller.gian=0.1": ["controller", "does not take 'gian'", "gain"],
    "+env.base.clearence=0.1": [BASE, "'clearence'", "clearance"],
    "env=robot/plant +env.base.robot.adress=x": [f"{BASE}.robot", "'adress'", "address"],
    "+env.inputs.goal.mean=0.1": ["env.inputs.goal", "expected loc and scale", "mean"],
    "+env.symmetry={}": ["env.symmetry: unknown key"],
    "+algorithm.agent.encoder.depth=2": [AGENT, "does not take 'depth'", "channels"],
    "algorithm.agent.encoder.strides=[4,2]": [AGENT, "expected lists of the same length"],
    "algorithm.agent.encoder.channels=32": [AGENT, "channels: expected a list of whole", "32"],
    "algorithm.agent.encoder.shift=-1": [AGENT, "shift: expected a whole number"],
    "+env.inputs.goal.channels=middle": ["env.inputs.goal.channels", "first, last, none"],
    "+env.sensing.pile={_target_:torchrl.envs.CatFrames,N:3,dim:-1,in_keys:[blocks]}": [
        "env.inputs.blocks.loc: expected 1 or 39 numbers, got 13",
    ],
    "+env.critic_inputs.wrench={}": ["env.critic_inputs", "does not have 'wrench'", "force_z"],
    # what the run gives itself
    "+env.base.num_envs=4": [f"{BASE}: ", "gets 'num_envs' from the run", "got 4"],
    "+algorithm.agent.episode_steps=9": [AGENT, "'episode_steps'", "9"],
    "+algorithm.exploration.spec=x": ["algorithm.exploration", "gets 'spec' from the run", "'x'"],
    "+env.renderer.width=64": ["env.renderer", "gets 'width' from the run", "64"],
    # unknown choices
    "env=insertion-mars": ["insertion-mars"],
    "algorithm=ppo": ["ppo"],
    "disturbance=wind": ["wind"],
    "safety=null": ["safety: expected one of its files, or ~safety for none, got null"],
    "env.base.variant=mars": [BASE, "variant", "'mars'", "real", "sim"],
    "env.batching=threads": ["env.batching", "native", "serial", "threads"],
    "trainer.matmul_precision=low": ["trainer.matmul_precision", "highest", "low"],
    "algorithm.agent.loss_function=l3": [AGENT, "l3"],
    "render.format=avi": ["render.format", "mp4", "avi"],
    "render.scenario=upside_down": ["render.scenario", "misaligned", "upside_down"],
    "render.episode=best": ["render.episode", "rescue", "best"],
    "render.episode=100": ["render.episode", "a number below 100", "100"],
    "render.episode=-1": ["render.episode", "a number below 100", "-1"],
    # an operator
    "operator=monkey": ["operator", "monkey"],
    "trainer.intervention_share=0.2": ["expected 0 without an operator", "0.2"],
    "trainer.intervention_share=1.5": ["trainer.intervention_share", "1.5"],
    "operator.intervention={_target_:rrl.Intervention,step_limit:0.1}": [
        "operator.intervention",
        "needs 'operator'",
    ],
    "~controller +controller={_target_:statistics.mean}": [
        "controller: statistics.mean needs 'data'",
        "under function: of rrl.controllers.FunctionController",
    ],
    "+operator.speed=1": ["operator.speed: unknown key", "1"],
    # wrong types
    "env.action_history=long": ["env.action_history", "integer", "long"],
    "trainer.num_seeds=two": ["trainer.num_seeds", "integer", "two"],
    "trainer.num_seeds=1.5": ["trainer.num_seeds", "integer", "1.5"],
    "trainer.num_seeds=null": ["trainer.num_seeds", "integer", "None"],
    "trainer.updates_per_step=often": ["trainer.updates_per_step", "number", "often"],
    "trainer.controller_steps=maybe": ["trainer.controller_steps", "integer", "maybe"],
    "trainer.evaluation=500": ["trainer.evaluation", "500"],
    "trainer.checkpoint.keep=all": ["trainer.checkpoint.keep", "integer", "all"],
    "residual_scale=large": ["residual_scale", "number", "large"],
    "env.max_episode_steps=long": ["env.max_episode_steps", "integer", "long"],
    "env.base.yaw_choices=[left]": [BASE, "yaw_choices", "left"],
    "+env.base.clearance=wide": [BASE, "clearance", "wide"],
    "algorithm.agent.network.hidden=big": [AGENT, "hidden", "whole numbers"],
    "algorithm.agent.network.hidden=[64,wide]": [AGENT, "wide"],
    "algorithm.agent.network.hidden=64": [AGENT, "hidden: expected a list of whole numbers", "64"],
    "logger.wandb.online=no": ["logger.wandb: online: expected true or false, got 'no'"],
    "logger.wandb.tags=abc": ["logger.wandb: tags: expected a list", "'abc'"],
    "controller._target_=null": ["controller", "_target_", "None"],
    "env.inputs=[goal]": ["env.inputs=[goal]", "DictConfig"],
    # out of range
    "env.action_history=0": ["env.action_history", "greater than 0", "0"],
    "trainer.num_seeds=0": ["trainer.num_seeds", "greater than 0", "0"],
    "trainer.num_seeds=-1": ["trainer.num_seeds", "greater than 0", "-1"],
    "trainer.seed=-1": ["trainer.seed", "-1"],
    "trainer.seed=99999999999": ["trainer.seed", "268435456", "99999999999"],
    "trainer.total_steps=-50": ["trainer.total_steps", "-50"],
    "trainer.batch_size=0": ["trainer.batch_size", "greater than 0"],
    "trainer.threads=0": ["trainer.threads", "greater than 0"],
    "trainer.updates_per_step=nan": ["trainer.updates_per_step", "nan"],
    "trainer.updates_per_step=inf": ["trainer.updates_per_step", "inf"],
    "trainer.evaluation.episodes=0": ["trainer.evaluation.episodes", "greater than 0"],
    "trainer.checkpoint.keep=0": ["trainer.checkpoint.keep", "greater than 0"],
    "residual_scale=-1": ["residual_scale: expected a number of at least 0, or a list of such"],
    "residual_scale=[1,-1]": ["residual_scale: expected a number of at least 0", "[1, -1]"],
    "trainer.realtime.weights=0": ["trainer.realtime.weights: expected episode or", "got 0"],
    "render.episode=1.5": ["render.episode: expected rescue or a number below 100, got 1.5"],
    "algorithm.agent.gamma=1.5": [AGENT, "gamma", "1.5"],
    "algorithm.agent.tau=0": [AGENT, "tau", "0"],
    "algorithm.agent.policy_delay=0": [AGENT, "policy_delay", "0"],
    "algorithm.agent.actor_lr=-0.001": [AGENT, "-0.001"],
    "algorithm.agent.network.hidden=[0]": [AGENT, "0"],
    "algorithm.exploration.eps_init=-0.1": ["algorithm.exploration", "eps_init", "-0.1"],
    "controller.gain=nan": ["controller", "gain", "nan"],
    "controller.gain=much": ["controller", "gain", "much"],
    "controller.unit=0": ["controller", "unit"],
    "env.base.num_threads=0": [BASE, "num_threads", "0"],
    "+env.base.platform_friction=-1": [BASE, "platform_friction", "-1"],
    "env.sensing.camera_noise.sigma=-0.001": ["env.sensing.camera_noise", "sigma", "-0.001"],
    "env.sensing.camera_latency.steps=-1": ["env.sensing.camera_latency", "-1"],
    "render.width=0": ["render.width", "greater than 0"],
    "render.fps=0": ["render.fps", "greater than 0"],
    # contradictions
    "env.symmetries.front_back.goal=[1,2]": [
        "env.symmetries.front_back.goal",
        "3 numbers",
        "[1, 2]",
    ],
    "env.symmetries.front_back.goal=[1,2,2]": ["env.symmetries", "the numbers 1 to 3 once each"],
    "~env.symmetries.front_back.goal": ["env.symmetries.front_back", "a map of 'goal'"],
    "env.symmetries.front_back.end_effector_position=[1,3,2]": [
        "end_effector_position: expected equal scales"
    ],
    "trainer.warmup_steps=10000": ["warmup_steps", "total_steps (10000)"],
    "trainer.controller_steps=10000": ["controller_steps", "total_steps (10000)", "explored"],
    "arm=controller trainer.total_steps=200": ["expected 0 with arm=controller", "got 200"],
    "arm=rl controller=proportional": ["controller=zero with arm=rl", "ProportionalController"],
    "trainer.steps_per_collection=30": ["total_steps", "10000", "steps_per_collection", "30"],
    "trainer.updates_per_step=0.333": ["updates_per_step", "0.333", "whole number"],
    "trainer.buffer_capacity=100": ["buffer_capacity", "100", "batch (128)"],
    "trainer.evaluation.every=75": ["evaluation.every", "75", "50"],
    "trainer.checkpoint.every=120": ["checkpoint.every", "120", "50"],
    "+env.base.yaw_range=0.1": [BASE, "yaw_range", "yaw_choices"],
    "env.scenarios.aligned.yaw_choices=[90.0]": ["env.scenarios.aligned", "yaw"],
    "+env.base.start_height=0.001": [BASE, "start_height"],
    "+env.inputs.wrench={}": ["env.inputs", "does not have 'wrench'", "force_z"],
    "env.inputs.goal.scale=[1.0,2.0]": ["env.inputs.goal", "3 numbers", "2"],
    "env.inputs.goal.loc=[a,b,c]": ["env.inputs.goal.loc"],
    "controller.position_key=tool": ["controller", "reads 'tool'", "end_effector_position"],
    # empty, missing, not there
    "env.scenarios=null": ["env.scenarios", "None"],
    "env.inputs=null": ["env.inputs", "None"],
    "~env.name": ["env.name: expected a value, got none"],
    "~env.inputs": ["env.inputs: expected a value"],
    "~env.base._target_": [BASE, "expected _target_"],
    "env.base._target_=nowhere.Env": [BASE, "got 'nowhere.Env'"],
    "controller._target_=rrl.controllers.Nothing": ["controller", "rrl.controllers.Nothing"],
    "controller._target_=rrl.controllers.PolicyController": ["controller", "does not take 'gain'"],
    "algorithm.agent._target_=3": [AGENT, "_target_", "3"],
    # paths
    "name=../../escaped": ["name", "../../escaped"],
    "name=/etc/rrl": ["name", "/etc/rrl"],
    "name=''": ["name", "''"],
}


@pytest.fixture(autouse=True)
def no_environment(monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("an environment was built before the configuration was checked")

    monkeypatch.setattr(InsertionEnv, "__init__", refuse)


def message_of(overrides):
    """What ``rrl train`` says of a configuration; empty if it finds nothing wrong."""
    try:
        assembly.check(compose(overrides.split()))
    except ValueError as error:
        return message(error)
    return ""


@pytest.mark.parametrize("override", BROKEN)
def test_a_broken_config_is_explained(override):
    message = message_of(override)
    assert message, "nothing was found"
    for fragment in BROKEN[override]:
        assert fragment in message, message
    assert "Traceback" not in message
    assert "constrained" not in message


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"total_step": 3}, "total_step\n  unknown key, got 3; did you mean total_steps? "),
        ({"gpu": 1}, "it takes seed, num_seeds"),
        ({"evaluation": {"evry": 3}}, "evaluation.evry\n  unknown key, got 3; did you mean every?"),
        ({"threads": 0}, "threads\n  expected a number greater than 0, got 0 "),
        ({"total_steps": 100, "warmup_steps": 300}, "warmup_steps: expected less than total_steps"),
    ],
)
def test_settings_in_python_are_explained_too(values, said):
    with pytest.raises(ValidationError) as caught:
        TrainerSettings(**values)
    assert said in str(caught.value)
    assert "pydantic.dev" not in str(caught.value)


@pytest.mark.parametrize("device", ["cuda:99", "gpu", "mps:99"])
def test_a_device_has_to_be_there_for_training_alone(device):
    config = compose([f"trainer.device={device}"])
    assembly.check(config)  # whoever evaluates a run needs no device of its own
    with pytest.raises(
        ValueError, match=r"^trainer\.device: expected a device of this machine, got"
    ):
        assembly.check(config, training=True)


def test_there_are_many():
    assert len(BROKEN) >= 50


def test_all_problems_come_at_once():
    config = compose([])
    config["trainer"]["num_seeds"] = 0
    config["render"]["fps"] = "slow"
    with pytest.raises(ValueError) as caught:
        assembly.check(config)
    assert [line.partition(":")[0] for line in str(caught.value).splitlines()] == [
        "trainer.num_seeds",
        "render.fps",
    ]


@pytest.mark.parametrize("group", ["disturbance", "safety", "operator", "logger", "init_from"])
def test_what_may_be_left_out_is_read_by_nobody(group):
    config = compose([])
    del config[group]
    assembly.check(config)
    assembly.environment(config)
    assembly.loggers(config)


def test_an_entry_that_sensing_writes_is_an_entry():
    stack = "{_target_:torchrl.envs.CatFrames,N:3,dim:-1,in_keys:[blocks],out_keys:[stacked]}"
    found = f"+env.sensing.stack={stack} +env.inputs.stacked={{}} algorithm.use_symmetries=false"
    assert message_of(found + " ~env.symmetries") == ""


def test_the_shipped_configuration_is_fine():
    assert message_of("trainer.seed=0") == ""


def test_a_scenario_names_no_file_elsewhere():
    config = compose([])
    config["env"]["scenarios"]["../up"] = {}
    with pytest.raises(ValueError, match=r"env.scenarios.../up"):
        assembly.check(config)
