"""The shape `ellipse` and the emitter `ellipticalarea` of scene files."""
