"""A frame and a calibration in, a surface out, stage by stage.

Read `problem_setup`, `colours`, `separation`, `reconstruct`, `scale`, `assumptions`, `sequence`,
`unknown_light`, `mesh`.
"""
