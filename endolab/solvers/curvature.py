"""How a surface bends: second differences of 1/d that are 0 on every plane, and what their size costs.

With w = 1/d and r the unit ray of a pixel, a plane n·x = h has w = n·r/h, linear in the ray. So where the
second differences of the rays are a r_u + b r_v + c r, those of w, less a w_u + b w_v + c w, vanish on
every plane, in every camera. These three are the surface's second fundamental form, but for a factor:
with κ₁, κ₂ the eigenvalues of this form against the metric G, both are 0 on a plane and one is 0 on every
surface that a sheet can be rolled into, a tube, a cone, straight, tilted or off centre. Charged are

    size κ = (κ₁² + κ₂²)^½,    twofold = κ₁ κ₂ / (κ² + SLIGHT²)^½,

the second by `TWOFOLD` times more: a wall bends one way at little cost. Neither needs an eigenvector,
and both are smooth but where nothing bends. κ is per (1/160 rad)², which is a pixel's square in the
middle of a picture 320 px and 90° wide, and of d over its median, as ξ/ξ̃ is.
"""

# What bending both ways costs, beside all bending. Tubes are 0.5 % off with 10, 0.9 % with 4, 3 % with 0; the
# more, the less smooth is along a tube what is smooth across.
TWOFOLD = 4.0
ANGLE = 1 / 160  # rad, the unit of curvatures
CREASE = 3.0  # times ε: where a curvature is charged its size, not its square; walls bend by less
# κ below which bending both ways hardly counts. To prefer one way is not convex: a ball, which bends by 2e-5
# at twice its distance from the middle, would crumple into facets. Tubes bend by 1e-4 and more.
SLIGHT = 5e-5
