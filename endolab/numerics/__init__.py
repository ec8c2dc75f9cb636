"""Arrays and loops that know nothing of endoscopes.

Read `arrays`, `stencils`, `penalties`, `roots`, `compiled`, `iteration`.
"""
