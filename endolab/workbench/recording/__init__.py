"""Recordings for the Rerun viewer, of every iterate, and their way back."""

from endolab._extras import need

need("rerun")
