"""The light, from how bright the paper is.

Read `samples`, `model`, `identifiability`, `lamps`, `result`, `fit`.
"""
