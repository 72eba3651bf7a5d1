"""Training on a GPU: no step waits for it. Where there is none, the operations of a step are looked through instead."""

import contextlib

import pytest
import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from beso import methods
from beso.training.loop import Training, side_by_side

GPU = torch.cuda.is_available()
DEVICES = ["cpu", *(["cuda"] if GPU else [])]
needs_gpu = pytest.mark.skipif(not GPU, reason="no GPU")

aten = torch.ops.aten
READ = {aten._local_scalar_dense, aten.equal, aten.is_nonzero}  # values
SIZED = {aten.nonzero, aten.masked_select, aten._unique2, aten.unique_dim, aten.unique_consecutive, aten.bincount}
INDEXED = {aten.index, aten.index_put, aten.index_put_, aten._index_put_impl_}
COPIED = {aten.lift_fresh}  # what torch.tensor does with numbers
ON_HOST = {torch.Tensor.cpu, torch.Tensor.numpy, torch.Tensor.tolist, torch.from_numpy, torch.as_tensor}
MADE = {torch.tensor, torch.zeros, torch.ones, torch.full, torch.empty, torch.arange, torch.linspace, torch.eye}
MADE |= {torch.rand, torch.randn, torch.randint}


class WaitError(AssertionError):
    """What would wait for a GPU."""


class Operations(TorchDispatchMode):
    """Refuses operations whose result, or its size, the host must read, and copies of its numbers."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        packet, kwargs = func.overloadpacket, kwargs or {}
        masked = packet in INDEXED and any(i is not None and i.dtype in (torch.bool, torch.uint8) for i in args[1])
        counted = func is aten.repeat_interleave.Tensor and kwargs.get("output_size") is None
        if masked or counted or packet in READ | SIZED | COPIED:
            raise WaitError(str(func))
        return func(*args, **kwargs)


class Calls(TorchFunctionMode):
    """Refuses tensors that are moved, or made without saying where: on the host."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        moved = func is torch.Tensor.to and ("device" in kwargs or any(isinstance(a, torch.device) for a in args))
        if moved or func in ON_HOST or (func in MADE and kwargs.get("device") is None):
            raise WaitError(func.__name__)
        return func(*args, **kwargs)


@contextlib.contextmanager
def never_waiting(device):
    """Fail where something within waits for a GPU, or would."""
    if device == "cuda":
        torch.cuda.synchronize()
        torch.cuda.set_sync_debug_mode("error")
    try:
        with Operations(), Calls():
            yield
    finally:
        if device == "cuda":
            torch.cuda.set_sync_debug_mode("default")


@pytest.mark.parametrize(
    "wait",
    [
        lambda x: x.sum().item(),
        lambda x: bool(x.sum() > 0),
        lambda x: float(x[0]),
        lambda x: x[x > 0],
        lambda x: x.masked_fill(x > 0, 1.0).unique(),
        lambda x: x.nonzero(),
        lambda x: x + torch.tensor(1.0),
        lambda x: x.new_tensor([1.0, 2.0, 3.0]),
        lambda x: x + torch.ones(3),
        lambda x: x.to(x.device),
        lambda x: x.tolist(),
        lambda x: x.detach().cpu().numpy(),
        lambda x: x.repeat_interleave(torch.ones(3, dtype=torch.long, device=x.device)),
    ],
)
def test_waits_are_found(wait):
    x = torch.randn(3)
    with pytest.raises(WaitError), never_waiting("cpu"):
        wait(x)


@pytest.fixture
def training(dataset, spec, teacher_of, tmp_path):
    """training(job, device, graph, state file) -> a training of the small dataset."""

    def training(job, device="cpu", graph=False, state="unused"):
        chosen = {"teacher": teacher_of(job), "graph": graph}
        return Training(job, dataset, spec, torch.device(device), tmp_path / state, **chosen)

    return training


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("precision", ["fp32", "bf16"])
@pytest.mark.parametrize("optimizer", ["adam", "muon"])
@pytest.mark.parametrize("name", methods.names())
def test_a_step_never_waits_for_the_gpu(training, make_job, name, optimizer, precision, device):
    begun = training(make_job(name, every=100, optimizer=optimizer, precision=precision), device)
    begun.step()  # what is made once, optimizer states and constants, may be copied
    with never_waiting(device):
        begun.step()
        begun.step()


@pytest.mark.parametrize("density", ["log_logistic", "log_normal", "uniform"])
def test_nor_does_another_training_noise(training, make_job, small_models, density):
    diffusion = {**small_models["c_beso"][0]["diffusion"], "density": density}
    begun = training(make_job("c_beso", every=100, model={"diffusion": diffusion}))
    begun.step()
    with never_waiting("cpu"):
        begun.step()


@pytest.mark.parametrize("device", DEVICES)
def test_data_weights_and_draws_are_on_the_device(training, make_job, device):
    begun = training(make_job("c_bet"), device)
    tensors = [value for value in vars(begun.windows).values() if isinstance(value, torch.Tensor)]
    tensors += [*begun.method.state_dict().values(), *begun.averaged.state_dict().values(), begun.draws]
    assert len(tensors) > 8
    assert {value.device.type for value in tensors} == {device}


@pytest.mark.parametrize("done", [0.0, 0.4, 0.6])
def test_a_method_says_when_its_loss_changes(training, make_job, done):
    """As a recording of it would not."""
    method = training(make_job("cfg_beso", model={"goal_dropout_from": 0.5})).method
    assert method.schedule(0.0), "until then, goals are dropped as they are without a schedule"
    assert method.schedule(done) == (done >= 0.5)
    assert not method.schedule(done)


@needs_gpu
@pytest.mark.parametrize("precision", ["fp32", "bf16"])
@pytest.mark.parametrize("optimizer", ["adam", "muon"])
@pytest.mark.parametrize("name", methods.names())
def test_a_cuda_graph_trains_as_single_kernels_do(training, make_job, name, optimizer, precision):
    """The same draws and losses but for rounding, through a change of the loss in the middle."""
    model = {"goal_dropout_from": 0.5} if name == "cfg_beso" else {}
    job = make_job(name, every=1, model=model, optimizer=optimizer, precision=precision)
    plain, graph = training(job, "cuda"), training(job, "cuda", graph=True)
    for finished in side_by_side([plain, graph]):
        assert finished.curve
    assert torch.equal(plain.draws.get_state(), graph.draws.get_state())
    for a, b in zip(plain.curve, graph.curve, strict=True):
        assert b["training_loss"] == pytest.approx(a["training_loss"], rel=0.02 if precision == "bf16" else 1e-3)


@needs_gpu
@pytest.mark.parametrize("graph", [False, True])
@pytest.mark.parametrize("name", methods.names())
def test_a_killed_run_continues_on_a_gpu(training, make_job, name, graph):
    undisturbed, killed = training(make_job(name), "cuda", graph), training(make_job(name), "cuda", graph, "state")
    for _ in range(5):
        killed.step()
    killed.save()
    continued = training(make_job(name), "cuda", graph, "state")
    assert continued.done == 5
    assert len(list(side_by_side([undisturbed, continued]))) == 2
    weights = undisturbed.result().weights
    assert all(torch.allclose(value, weights[key], atol=1e-3) for key, value in continued.result().weights.items())
