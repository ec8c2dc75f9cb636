"""What people look at: figures, recordings, reports of a run, and the tuner."""

from endolab.workbench import plots as plots
