"""Discovery of the rest of the fleet: heartbeats in, discovery events out. Paper A, section 4.2, Fig. 3."""
