"""The endoscope and what its light does: rays, lamps, walls.

Read `cameras`, `surface`, `lights`, `brdf`, `photometry`, `mesh`, `endoscope`.
"""
