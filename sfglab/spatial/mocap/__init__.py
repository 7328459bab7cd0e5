"""Motion capture: the detected poses of agents, published as TF so that each agent keeps one TF tree."""
