"""``python -m sfglab.fleet.decoder CONFIG``: a decoder that reports JSON lines; see `app`."""

import json
import sys

from sfglab.fleet.decoder.app import DecoderConfig, serve_reports
from sfglab.pipes import claim_standard_output, run, standard_input_lines

if __name__ == "__main__":
    write = claim_standard_output()
    run(
        serve_reports(
            DecoderConfig.from_json(sys.argv[1]),
            standard_input_lines(),
            lambda report: write(json.dumps(report).encode() + b"\n"),
        )
    )
