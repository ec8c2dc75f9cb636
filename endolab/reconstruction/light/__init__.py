"""Light that came by way of other walls, and the light of an endoscope: both are told by frames."""
