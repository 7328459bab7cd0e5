"""Status of an agent: heartbeats and a description for whoever asks. Paper A, section 4.2."""
