"""Decode once per device, on demand: paper A, section 4.3, Fig. 4.

Bottom up: `lifecycle` (the table of a pipeline's states), `demand` (who wants what), `streams` (names of
remote and local topics), `agents` (who offers them), `protocol` (words between processes), `joiner` (how a
stream under way is joined), `pipeline` and `worker` (the decoding process), `pool` (its processes), `node` (the
decoder), `app` (the decoder as a process).
"""

__all__: list[str] = []
