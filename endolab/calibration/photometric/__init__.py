"""The light, from how bright the paper is.

Read `samples`, `model`, `identifiability`, `result`, `fit`.
"""
