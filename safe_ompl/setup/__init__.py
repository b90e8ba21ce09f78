"""SafeSetup, OMPL's SimpleSetup for a robot in a scene; and the results of planning."""
