"""What a picture shows before anything is solved.

Read `surround`, `frame`, `highlights`, `boxes`, `undistort`.
"""
