"""Our rules for Dockerfiles: each finds what breaks it, and what is right is read right."""

import pytest

from sfglab.deploy.dockerfile_check import check_dockerfile, parse_dockerfile, stages_of

GOOD = """\
# A comment.
ARG BASE=debian:12.11
FROM ${BASE} AS base
FROM base AS adapter
RUN true \\
    # between
    && echo "# not a comment"
FROM adapter AS application
USER 10001:10001
"""
DIGEST = "sha256:" + "a" * 64


def codes(text: str) -> list[tuple[str, int]]:
    return [(finding.code, finding.place.line) for finding in check_dockerfile(text)]


def test_nothing_is_wrong_with_what_is_right_and_continued_lines_are_one_instruction():
    assert codes(GOOD) == []
    assert codes(GOOD.replace("debian:12.11", f"debian@{DIGEST}")) == []
    assert codes(GOOD + "FROM application AS development\nUSER 0\nUSER sfglab\n") == []
    text = GOOD + "COPY <<A <<B /x/\na\nA\nb\nB\nRUN true\n"
    steps = parse_dockerfile(text)
    assert [step.line for step in steps] == [2, 3, 4, 5, 8, 9, 10, 15]
    assert steps[3].value == 'true && echo "# not a comment"'
    assert [(stage.name, stage.image) for stage in stages_of(steps)] == [
        ("base", "${BASE}"),
        ("adapter", "base"),
        ("application", "adapter"),
    ]


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("ENV DB_PASSWORD=hunter2", "secret"),
        ("ENV API_TOKEN hunter2", "secret"),
        ("ARG SIGNING_KEY='hunter2'", "secret"),
        ("ADD https://example.org/x.tar.gz /x", "unchecked-download"),
        ("RUN curl -fsSL https://example.org/x | sh", "piped-script"),
        ("RUN wget -qO- https://example.org/x | sudo bash", "piped-script"),
        ("COPY . /src", "copies-everything"),
        ("FLY away", "dockerfile-syntax"),
        ("USER root", "runs-as-root"),
        ("USER 0:10001", "runs-as-root"),
        ("RUN cat <<END", "dockerfile-syntax"),
        ("WORKDIR", "dockerfile-syntax"),
    ],
)
def test_a_broken_rule_is_found(line, code):
    assert [found for found, _ in codes(GOOD + line + "\n")] == [code]


@pytest.mark.parametrize(
    "line",
    [
        "ARG API_TOKEN",
        'ENV API_TOKEN=""',
        "ENV MONKEY=banana KEYBOARD=de",
        f"ADD --checksum={DIGEST} https://example.org/x /x",
        "RUN curl -fsSL -o /tmp/x https://example.org/x && sh /tmp/checked",
        "COPY --from=adapter . /src",
        "RUN <<END\nFLY away\nEND",
    ],
)
def test_what_only_looks_like_a_broken_rule_is_none(line):
    assert codes(GOOD + line + "\n") == []


@pytest.mark.parametrize(
    "image", ["debian", "debian:latest", "localhost:5000/debian", "debian@sha256:abc", "${GIVEN}"]
)
def test_an_unpinned_image_is_found_where_it_is_used(image):
    assert codes(GOOD.replace("${BASE}", image)) == [("unpinned-image", 3)]

    assert codes(GOOD.replace("12.11", "latest")) == [("unpinned-image", 3)], "also where it is a default"


DEVELOPMENT = "FROM application AS development\nUSER {}\n"
NOBODY = "USER 10001:10001\n"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (GOOD.replace("AS adapter", "AS middle").replace("FROM adapter", "FROM middle"), [("layers", 3)]),
        (GOOD.replace("FROM adapter", "FROM base"), [("layers", 8)]),
        ("RUN true\n", [("no-stage", 0), ("layers", 0)]),
        (GOOD.replace(NOBODY, ""), [("runs-as-root", 8)]),
        (GOOD + DEVELOPMENT.format("root"), [("runs-as-root", 10)]),
        (GOOD.replace(NOBODY, DEVELOPMENT.format(1)), [("runs-as-root", 8)]),
    ],
)
def test_layers_stand_on_each_other_and_neither_the_last_nor_the_application_is_roots(text, found):
    assert codes(text) == found
