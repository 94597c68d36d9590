"""Arrays only, no files: modes, plates, connections and their laws, the step, passivity, accounts of energy."""
