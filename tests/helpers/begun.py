import numba

numba.njit(lambda number: number)(1)  # the first compilation of a process takes longer than others
