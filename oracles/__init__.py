"""What lights do, computed another way: one set of truths for the tests and the benchmarks.

Nothing in here imports the package under test. `ellipse` has closed forms and quadrature in double
precision, and lights with references in 700-bit arithmetic; `lights` draws random lights by class;
`pictures` says what may be concluded from the difference of two pictures.
"""
