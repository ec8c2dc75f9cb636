"""Scenes whose truth is known, rendered by the model or path-traced.

Read `scenes`, `rendering`, `mucosa`, `path_tracing`.
"""
