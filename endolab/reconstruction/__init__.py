"""A frame and a calibration in, a surface out, stage by stage.

Read `problem_setup`, `colours`, `separation`, `reconstruct`, `scale`, `sentences`, `sequence`,
`unknown_light`, `mesh`.
"""
