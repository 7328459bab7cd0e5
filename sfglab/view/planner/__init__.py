"""The scene editor in the browser, on viser (extra ``view``). Paper A, section 4.5, Fig. 7.

The package is a user interface of `sfglab.spatial.scene.editor`. Three modules compute values only: `fields`
(inspector), `looks` (rows of the hierarchy, colours, lines) and `drawing` (nodes of the 3D view). The others use
viser: `context` (all edits in one thread, in order), `viewport`, `panels`, `sending`, `toolbar`, and `server`, which
connects them.
"""
