"""Cache validators of resources and list pages: tuples that are equal while the representation is unchanged.

Rows of masks and plans never change, those of scans and jobs count their revisions; progress alone is written without
one, so it is part of the stamp. A row that was deleted and made again has another time or identifier. A job by itself
that is not over has none, as its look tells its place among others.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from sqlalchemy import ColumnElement, Connection, Select, String, bindparam, select, type_coerce

from steradian.storage.db.tables import Base, JobRow, MaskRow, PlanRow, ScanRow

Validator: TypeAlias = tuple[Any, ...]
"""Equal ones mean equal looks; an empty one means that there is nothing, or nothing that tells."""
MAX_CURSOR: Final = 2**31 - 1
"""More than the number of any row."""


@dataclass(frozen=True)
class ValidatorKey:
    """Key of a cache validator: a resource, or, without ``id``, a page of a list."""

    noun: str
    id: str | None = None
    limit: int = 100
    before: int = MAX_CURSOR


def load_validators(connection: Connection, questions: Iterable[ValidatorKey]) -> dict[ValidatorKey, Validator]:
    """Load the cache validators of several resources and list pages with few queries."""
    found: dict[ValidatorKey, Validator] = {}
    single: dict[str, list[str]] = defaultdict(list)
    for question in questions:
        if question.id is not None:
            single[question.noun].append(question.id)
        else:
            wanted = {"before": question.before, "most": question.limit + 1}
            found[question] = tuple(map(tuple, connection.execute(_PAGE_QUERIES[question.noun], wanted)))
    for noun, identifiers in single.items():
        rows = {row[0]: tuple(row) for row in connection.execute(_ITEM_QUERIES[noun], {"ids": identifiers})}
        found |= {ValidatorKey(noun, identifier): rows.get(identifier, ()) for identifier in identifiers}
    return found


def _columns(table: type[Base]) -> tuple[ColumnElement[Any], ...]:
    columns = table.__table__.c
    if "revision" in columns:
        return columns.revision, columns.stage, columns.done, columns.total
    return (type_coerce(columns.created, String),)


_TABLES: Final[dict[str, type[Base]]] = {
    "masks": MaskRow,
    "plans": PlanRow,
    "scans": ScanRow,
    "reconstructions": JobRow,
    "jobs": JobRow,
}
_ITEM_QUERIES: Final[dict[str, Select[Any]]] = {}
_PAGE_QUERIES: Final[dict[str, Select[Any]]] = {}
for _noun, _table in _TABLES.items():  # once, as building a statement costs more than having it answered
    _rows = _table.__table__
    _query = select(_rows.c.id, *_columns(_table))
    if _noun == "reconstructions":
        _query = _query.where(_rows.c.resource == "reconstruction")
    _over = [_rows.c.ended.is_not(None)] if _table is JobRow else []
    _ITEM_QUERIES[_noun] = _query.where(_rows.c.id.in_(bindparam("ids", expanding=True)), *_over)
    _newest = _query.where(_rows.c.sequence < bindparam("before")).order_by(_rows.c.sequence.desc())
    _PAGE_QUERIES[_noun] = _newest.limit(bindparam("most"))
