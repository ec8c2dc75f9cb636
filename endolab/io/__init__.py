"""Files in and out: whole or not there, and every complaint one sentence."""
