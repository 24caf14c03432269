"""Plans that come in parts: put together in order, bounded in number, size and time."""

from __future__ import annotations

import pytest

from skygcs.core.plan.file_reading import MAX_FILE_BYTES
from skygcs.errors import RefusedError
from skygcs.ext.plans.plan_uploads import KEPT_S, MAX_PART_CHARS, MAX_UPLOADS, PlanUploads
from support.table import each


def test_parts_are_put_together_and_used_up() -> None:
    uploads = PlanUploads()
    number, size = uploads.add(None, '{"a"', 10.0)
    assert size == 4
    assert uploads.add(number, ": 1}", 11.0) == (number, 8)
    assert uploads.take(number, 12.0) == b'{"a": 1}'
    with pytest.raises(RefusedError, match=f"no upload {number}"):
        uploads.take(number, 12.0)


def test_uploads_of_two_clients_do_not_mix() -> None:
    uploads = PlanUploads()
    one, _ = uploads.add(None, "a", 0.0)
    other, _ = uploads.add(None, "b", 0.0)
    uploads.add(one, "a", 0.0)
    assert (uploads.take(one, 0.0), uploads.take(other, 0.0)) == (b"aa", b"b")


def test_no_more_than_a_few_are_kept_and_the_forgotten_go() -> None:
    uploads = PlanUploads()
    for _ in range(MAX_UPLOADS):
        uploads.add(None, "x", 0.0)
    with pytest.raises(RefusedError, match="4 plans are being uploaded already"):
        uploads.add(None, "x", KEPT_S)
    uploads.add(None, "x", KEPT_S + 0.1)
    assert len(uploads) == 1


def test_one_that_grows_too_large_is_dropped() -> None:
    uploads = PlanUploads()
    number, size = uploads.add(None, "x" * MAX_PART_CHARS, 0.0)
    with pytest.raises(RefusedError, match="at most 32 MiB"):
        while size <= MAX_FILE_BYTES:
            _, size = uploads.add(number, "x" * MAX_PART_CHARS, 0.0)
    assert len(uploads) == 0


@each("number", [0, -1, 99])
def test_an_unknown_number_is_refused_for_parts_and_for_plans(number: int) -> None:
    uploads = PlanUploads()
    with pytest.raises(RefusedError, match=f"no upload {number}"):
        uploads.add(number, "x", 0.0)
    with pytest.raises(RefusedError, match=f"no upload {number}"):
        uploads.take(number, 0.0)


def test_text_that_is_none_is_kept_for_the_reader_to_refuse() -> None:
    uploads = PlanUploads()
    number, _ = uploads.add(None, "\ud800", 0.0)
    assert uploads.take(number, 0.0) == b"?"
