"""How far a surface can be trusted, who decided each pixel, and how smooth it is best made."""
