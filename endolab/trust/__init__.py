"""How far a surface can be trusted, and how smooth it is best made: between solving and reconstructing."""
