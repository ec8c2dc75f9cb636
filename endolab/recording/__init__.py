"""Recordings for the Rerun viewer, of every iterate, and their way back."""

import os

from endolab._extras import need

need("rerun")
# Of a disk that is full Rerun complains on its own, before `stream.Sink` says so in a sentence.
os.environ.setdefault("RUST_LOG", "warn,re_log_encoding=off,re_sdk=off")
