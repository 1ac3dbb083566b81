"""Irradiance at points of a scene, and illuminance on planes as lighting reports have it."""
