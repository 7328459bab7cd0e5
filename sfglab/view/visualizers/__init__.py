"""Visualizers that come with sfglab, by what they show; `sfglab.view.session` lists them."""
