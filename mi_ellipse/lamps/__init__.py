"""Lamps: geometry, strategy and radiance together, without Mitsuba's emitter interface."""
