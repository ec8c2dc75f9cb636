"""The light, from how bright the paper is.

Read `samples`, `model`, `fit`, `result`, `identifiability`.
"""
