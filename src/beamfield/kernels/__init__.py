"""Plain loops compiled by Numba; nothing else in beamfield is compiled.

Arrays and scalars in, the caller's `out` filled: no validation, no exceptions, no allocation in inner loops. Kernels of
other files are imported by name, at the top: `jit` has Numba's disk cache notice changes in the files that it finds so.
"""
