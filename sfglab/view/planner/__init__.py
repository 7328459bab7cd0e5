"""The scene editor in the browser, on viser (extra ``view``). Paper A, section 4.5, Fig. 7.

A thin shell over `sfglab.spatial.scene.editor`. Pure: `fields` (inspector), `looks` (rows of the hierarchy,
colours, lines), `drawing` (nodes of the 3D view as values). Viser: `context` (all edits in one thread, in order),
`viewport`, `panels`, `sending`, `toolbar`, and `server`, which joins them.
"""
