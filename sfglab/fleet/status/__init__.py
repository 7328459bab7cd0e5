"""Status of an agent: heartbeats and a description for other agents. Paper A, section 4.2."""
