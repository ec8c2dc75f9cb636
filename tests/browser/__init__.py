"""Tests that need a JupyterLab and a browser."""
