"""The scene editor in the browser, on viser (extra ``view``). Paper A, section 4.5, Fig. 7.

A thin shell over `sfglab.spatial.scene.editor`. Pure: `forms` (inspector), `looks` (rows of the hierarchy,
colours, lines). Viser: `context` (all edits in one thread, in order), `drawing`, `viewport`, `panels`,
`toolbar`, and `server`, which joins them.
"""
