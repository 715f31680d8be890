"""Which processor computes: "cpu", or "cuda" where Numba finds a GPU."""

from __future__ import annotations

from importlib.util import find_spec

from numba import config

from beamfield.errors import InvalidInputError, MissingDependencyError, needs

# Whether Numba runs device code as Python (NUMBA_ENABLE_CUDASIM=1), which needs no GPU.
IN_SIMULATOR = bool(vars(config)["ENABLE_CUDASIM"])
# What installs Numba's CUDA target, and the extra of beamfield that asks for it.
PACKAGE, EXTRA = "numba-cuda[cu12]", "cuda"


def require_device(device: str) -> None:
    """Raise unless the processor is there; nothing of CUDA is loaded for "cpu".

    Parameters
    ----------
    device
        "cpu" or "cuda".

    Raises
    ------
    InvalidInputError
        If it is neither, or there is no GPU.
    MissingDependencyError
        If numba-cuda is not installed. Numba's CUDA simulator (NUMBA_ENABLE_CUDASIM=1) needs neither it nor a GPU.
    """
    if device not in ("cpu", "cuda"):
        raise InvalidInputError(f"device: expected 'cpu' or 'cuda', got {device!r}")
    if device == "cpu":
        return
    if not IN_SIMULATOR and find_spec("numba_cuda") is None:
        raise MissingDependencyError(PACKAGE, EXTRA, "device='cuda'")
    with needs(PACKAGE, EXTRA, "device='cuda'"):
        from numba import cuda
    if not cuda.is_available():
        raise InvalidInputError("device: expected a GPU and its driver for 'cuda', found none; device='cpu' needs none")
