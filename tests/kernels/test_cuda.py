"""device="cuda" against the CPU, in Numba's CUDA simulator or on a GPU; what is said where there is none."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import cuda

import beamfield as bf
from beamfield.errors import InvalidInputError, MissingDependencyError
from beamfield.kernels import device

pytestmark = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="the simulator is compared with the CPU's compiled kernels"
)


@pytest.fixture(scope="module")
def on_cuda() -> dict[str, Any]:
    has_gpu = find_spec("numba_cuda") is not None and cuda.is_available()
    command = [sys.executable, "-W", "error", "-m", "tests.kernels.cuda_against_cpu"]
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "0" if has_gpu else "1"}
    done = subprocess.run(command, cwd=Path(__file__).parents[2], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def test_cuda_is_not_loaded_for_the_cpu(on_cuda: dict[str, Any]) -> None:
    assert on_cuda["CUDA is loaded for the CPU"] == 0


def test_rays_have_the_same_bits(on_cuda: dict[str, Any]) -> None:
    assert on_cuda["ranges of walls"] > 50
    assert on_cuda["ranges that differ"] == 0


@pytest.mark.parametrize("name", ["mixture", "only hits"])
def test_the_beam_model_is_the_same_to_the_last_digits(on_cuda: dict[str, Any], name: str) -> None:
    assert on_cuda[name] < 1e-12


@pytest.mark.parametrize("name", ["field", "impossible"])
def test_likelihood_fields_are_the_same_to_the_last_digits(on_cuda: dict[str, Any], name: str) -> None:
    assert on_cuda["scans that are impossible"] > 3
    assert on_cuda[name] < 1e-12
    assert on_cuda[f"no scan, {name}"] == 0.0


@pytest.mark.parametrize("name", ["mixture", "slope", "far too narrow", "impossible"])
@pytest.mark.parametrize("what", ["E-step", "Newton"])
def test_passes_of_learning_are_the_same_to_the_last_digits(on_cuda: dict[str, Any], what: str, name: str) -> None:
    assert on_cuda[f"{what}, {name}"] < 1e-12


def test_learning_ends_at_the_same_parameters(on_cuda: dict[str, Any]) -> None:
    assert on_cuda["iterations"] == on_cuda["iterations on the CPU"] > 5
    assert on_cuda["fit"] < 1e-12
    assert on_cuda["no returns"] == 0.0


def test_too_little_memory_is_told(on_cuda: dict[str, Any]) -> None:
    expected = r"device: expected 2496 bytes of free memory on the GPU, got (\d+|inf) bytes"
    assert re.fullmatch(expected, on_cuda["without memory"])


@pytest.fixture
def grid() -> bf.OccupancyGrid:
    return bf.OccupancyGrid(np.array([[0.0, 1.0]]), resolution=1.0)


def test_a_missing_package_is_named_at_selection(grid: bf.OccupancyGrid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "find_spec", lambda _: None)
    with pytest.raises(MissingDependencyError, match=r"device='cuda' needs .*numba-cuda.*beamfield\[cuda\]"):
        bf.RayCaster(grid, device="cuda")


def test_a_missing_gpu_is_told_at_selection(grid: bf.OccupancyGrid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "find_spec", lambda name: name)
    monkeypatch.setattr(cuda, "is_available", lambda: False)
    parameters = bf.BeamParameters(0.7, 0.1, 0.1, 0.1, sigma_hit=0.05, lambda_short=0.5)
    for make in (
        lambda: bf.RayCaster(grid, device="cuda"),
        lambda: bf.BeamModel(grid, parameters, device="cuda"),
        lambda: bf.LikelihoodFieldModel(grid, bf.LikelihoodFieldParameters(0.8, 0.2, 0.05), device="cuda"),
        lambda: bf.learn_intrinsic_parameters(np.ones(20), np.ones(20), 8.0, device="cuda"),
    ):
        with pytest.raises(InvalidInputError, match="device: expected a GPU and its driver for 'cuda', found none"):
            make()


def test_options_that_a_gpu_has_not_are_refused(grid: bf.OccupancyGrid, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InvalidInputError, match="device: expected 'cpu' or 'cuda', got 'gpu'"):
        bf.RayCaster(grid, device="gpu")  # type: ignore[arg-type]
    monkeypatch.setattr("beamfield.models.likelihood_field.require_device", lambda _: None)
    monkeypatch.setattr("beamfield.models.beam.require_device", lambda _: None)
    parameters = bf.LikelihoodFieldParameters(0.8, 0.2, 0.05)
    with pytest.raises(InvalidInputError, match="interpolation: device='cuda' needs 'nearest', got 'bilinear'"):
        bf.LikelihoodFieldModel(grid, parameters, interpolation="bilinear", device="cuda")
    beams, on_cpu = bf.BeamParameters(0.7, 0.1, 0.1, 0.1, sigma_hit=0.05, lambda_short=0.5), bf.RayCaster(grid)
    with pytest.raises(InvalidInputError, match="caster: expected a RayCaster with device='cuda'"):
        bf.BeamModel(grid, beams, caster=on_cpu, device="cuda")
