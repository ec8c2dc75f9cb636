"""Arrays and loops that know nothing of endoscopes.

Read `arrays`, `stencils`, `roots`, `compiled`, `iteration`.
"""
