"""The endoscope and what its light does: rays, lamps, walls.

Read `cameras`, `surface`, `thinned`, `lights`, `brdf`, `photometry`, `mesh`, `schema`, `endoscope`.
"""
