"""The endoscope and what its light does: rays, lamps, walls, bounces.

Read `cameras`, `surface`, `lights`, `brdf`, `photometry`, `interreflection`, `mesh`, `schema`, `endoscope`.
"""
