"""TF frames with time: a buffer of transforms with lookup at any time in it, a listener, and a check of TF trees."""
