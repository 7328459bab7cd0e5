"""``python -m sfglab.fleet.decoder CONFIG``: a decoder that reports JSON lines; see `app`."""

import asyncio
import json
import sys

from sfglab.fleet.decoder.app import DecoderConfig, serve_reports
from sfglab.pipes import claim_standard_output, standard_input_lines

if __name__ == "__main__":
    write = claim_standard_output()
    asyncio.run(
        serve_reports(
            DecoderConfig.from_json(sys.argv[1]),
            standard_input_lines(),
            lambda report: write(json.dumps(report).encode() + b"\n"),
        )
    )
