"""From brightness to depth: the problem, its energy, the solvers.

Read `problem`, `energy`, `descent`, `result`, `fast_marching`, `gauss_newton`, `primal_dual`, `solvers`;
beside them `energy_kernels`, `grid`, `normal_equations`, `multigrid`, the compiled parts of Gauss-Newton;
`linearised` and `mesh`, what is made of a surface.
"""
