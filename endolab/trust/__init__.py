"""How far a surface can be trusted: what is uncertain, what it does to each pixel, and who decided it."""
