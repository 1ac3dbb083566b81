"""Where the fitted and tuned numbers of the package come from: one script for each group."""
