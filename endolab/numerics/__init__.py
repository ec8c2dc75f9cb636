"""Arrays and loops that know nothing of endoscopes.

Read `arrays`, `derivatives`, `penalties`, `roots`, `compiled`, `iteration`.
"""
