"""Agent as a whole: the nodes of paper A, sections 4.1 to 4.3, kept alive by one supervisor."""
