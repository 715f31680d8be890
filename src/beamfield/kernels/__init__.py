"""Plain loops compiled by Numba; nothing else in beamfield is compiled.

Arrays and scalars in, the caller's `out` filled: no validation, no exceptions, no allocation in inner loops. A kernel
calls only functions of its own file, because Numba's disk cache does not notice a change in another one.
"""
