"""What a picture shows before anything is solved.

Read `frame`, `highlights`, `contours`, `prepare`.
"""
