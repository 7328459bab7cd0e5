"""Motion capture: where cameras see the agents, published so that every agent's tree of frames stays whole."""
