"""Files in and out, and published frames."""

from endolab.io import datasets as datasets
