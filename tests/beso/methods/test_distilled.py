"""A student against its teacher's sampler, and against a teacher whose ODE is known."""

import copy

import pytest
import torch

from beso import methods
from beso.config import build
from beso.errors import UserError
from tests.beso.methods import SIZES, batch

CONTEXT = 3


def draws(seed=0):
    return torch.Generator().manual_seed(seed)


@pytest.fixture
def make(small_models):
    """make(name, transformer={}, sampling={}, **model) -> a policy that depends on its inputs, and its Config."""

    def make(name, transformer=None, sampling=None, seed=0, **model):
        module, (values, sample) = methods.load(name), small_models[name]
        values = {**values, **model, "transformer": {**values["transformer"], **(transformer or {})}}
        config = build(module.Config, values, "model")
        chosen = build(methods.sampling(name), {**sample, **(sampling or {})}, "sampling")
        policy = module.Method(config, chosen, SIZES, draws(seed)).eval()
        with torch.no_grad():  # an initial network hardly does
            for parameter in policy.parameters():
                parameter.mul_(2)
        return policy, config

    return make


class Played:
    """Hands the loss a batch and notes the actions that the teacher is asked for."""

    def __init__(self, student):
        self.inputs, self.answers, taught = [], [], student.taught

        def noted(*inputs):
            self.inputs.append(inputs)
            self.answers.append(taught(*inputs))
            return self.answers[-1]

        student.taught = noted


class GivenNoise:
    def __init__(self, normal):
        self.values = normal

    def normal(self, *shape):
        return self.values


def acted(policy, inputs):
    """What a policy does in a context, from a given first sample."""
    noise, context, observations, goal = inputs
    scale = policy.diffusion.action_range
    start = GivenNoise(noise / policy.diffusion.sigma_max)
    with torch.no_grad():
        return policy.act(observations, context / scale, goal, start, {})


@pytest.mark.parametrize("action_range", [1.0, 3.0])
@pytest.mark.parametrize(("steps", "teacher_steps"), [(1, 3), (2, 3), (2, 5)])
def test_the_target_is_what_the_teachers_sampler_does_and_the_loss_is_the_distance_from_it(
    make, small_models, steps, teacher_steps, action_range
):
    diffusion = {**small_models["c_beso"][0]["diffusion"], "action_range": action_range, "sigma_max": 1.5}
    sampling = {"steps": teacher_steps, "sigma_max": 1.5}
    teacher, _ = make("c_beso", diffusion=diffusion, sampling=sampling)
    student, _ = make("distilled", diffusion=diffusion, steps=steps, teacher_steps=teacher_steps, seed=1)
    student.learn_from(teacher)
    played = Played(student)
    with torch.no_grad():
        loss = student.loss(batch(8, CONTEXT), draws())  # 3, 3 and 2 samples
        distances = []
        for inputs, answer in zip(played.inputs, played.answers, strict=True):
            expected = acted(teacher, inputs)
            assert torch.allclose(answer[:, -1] / action_range, expected, atol=1e-5)
            distances.append((acted(student, inputs) - expected).square())
    assert loss.item() == pytest.approx(torch.cat(distances).mean().item(), rel=1e-4)
    lengths = [inputs[2].shape[1] for inputs in played.inputs]
    assert lengths == [1, 2, 3], "contexts grow at the start of an episode"


def test_with_as_many_steps_a_student_has_nothing_to_learn(make):
    teacher, _ = make("c_beso")
    student, _ = make("distilled", steps=3, seed=1)
    student.learn_from(teacher)
    assert student.loss(batch(6, CONTEXT), draws()).item() == 0


@pytest.mark.parametrize("steps", [1, 2])
def test_a_student_reaches_its_teacher_and_leaves_it_alone(make, steps):
    window = {"window": 1, "attention_dropout": 0.0, "residual_dropout": 0.0}
    teacher, _ = make("c_beso", transformer=window)
    student, _ = make("distilled", transformer=window, steps=steps, seed=1)
    before = copy.deepcopy(teacher.state_dict())
    student.learn_from(teacher)
    held_out = batch(200, 1, seed=99)
    start = student.eval().loss(held_out, draws(99)).item()
    optimizer = torch.optim.Adam(student.parameters(), 2e-3)
    for i in range(60):
        student.train().loss(batch(64, 1, seed=i), draws(i)).backward()
        optimizer.step()
        optimizer.zero_grad()
    assert student.eval().loss(held_out, draws(99)).item() < start / 4
    after = teacher.state_dict()
    assert all(torch.equal(before[key], after[key]) for key in before)
    assert before.keys() == student.state_dict().keys(), "the teacher is not part of its student"


def test_a_copy_has_the_same_teacher(make):
    """The averaged weights are a copy, and are measured."""
    student, _ = make("distilled")
    student.learn_from(make("c_beso")[0])
    twin = copy.deepcopy(student)
    assert twin.taught is student.taught
    data = batch(4, CONTEXT)
    assert torch.equal(twin.loss(data, draws(1)), student.loss(data, draws(1)))


def test_what_cannot_teach_is_refused(make):
    _, student = make("distilled")
    _, teacher = make("c_beso")
    student.check_teacher(teacher)
    with pytest.raises(ValueError, match="needs a teacher, not play data"):
        student.check_teacher(None)
    with pytest.raises(ValueError, match=r"the teacher's transformer is .*width=16.* and the student's .*width=32"):
        student.check_teacher(make("c_beso", transformer={"width": 16})[1])
    with pytest.raises(ValueError, match="the teacher's transformer is None"):
        student.check_teacher(methods.load("gcbc").Config(32, 2, 0.1))
    with pytest.raises(ValueError, match="learns from play data, not from a teacher"):
        teacher.check_teacher(teacher)


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"steps": 0}, "steps = 0: must be at least 1"), ({"steps": 4}, "teacher_steps = 3: must be at least steps = 4")],
)
def test_impossible_numbers_of_steps_are_refused(make, changes, message):
    with pytest.raises(UserError, match=message):
        make("distilled", **changes)
