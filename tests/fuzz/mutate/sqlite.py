"""Changes to SQLite bags: cells of any type, rows, tables, messages; or the bytes of the pages."""

from __future__ import annotations

import random
import sqlite3
from contextlib import closing

from tests.fuzz.mutate.havoc import havoc, overwrite_number
from tests.fuzz.mutate.message import mutate_definition, mutate_message

VALUES: tuple[object, ...] = (
    None, 0, 1, -1, 2**31, 2**53, 2**63 - 1, -(2**63), 0.5, -1e300, float("inf"), "", "text", "1.5", "\x1b[2J\n",
    "x" * 3000,
    b"", b"\x00\x01\x00\x00", b"\xff" * 40, "cdr", "json", "sensor_msgs/msg/LaserScan", "nav_msgs/msg/OccupancyGrid",
    "/scan",
    "/tf", "tf2_msgs/msg/TFMessage", "ros2msg", "ros2idl", "float32[] ranges", "module a { struct b { float c; }; };",
    "- history: 3\n  depth: 0\n", "[", "&a [*a]",
)  # fmt: skip
STATEMENTS = (
    "DROP TABLE {table}", "DELETE FROM {table}", "ALTER TABLE {table} RENAME TO other", "CREATE TABLE extra (a)",
    "ALTER TABLE {table} ADD COLUMN extra DEFAULT 'x'", "ALTER TABLE {table} RENAME COLUMN {column} TO other",
    "INSERT INTO {table} SELECT * FROM {table}", "UPDATE schema SET schema_version = 2",
    "UPDATE schema SET schema_version = 3",
    "DROP TABLE schema", "UPDATE {table} SET {column} = NULL", "UPDATE {table} SET {column} = 'text'",
    "UPDATE messages SET timestamp = -timestamp", "UPDATE messages SET topic_id = topic_id % 2 + 1",
    "DROP TABLE {table}; CREATE VIEW {table} AS SELECT 1 AS id", "PRAGMA user_version = 7", "PRAGMA application_id = 3",
    "PRAGMA writable_schema = ON; UPDATE sqlite_master SET sql = 'x' WHERE name = '{table}'",
)  # fmt: skip


def mutate_sqlite(content: bytes, rng: random.Random) -> bytes:
    """Change one thing of a SQLite bag."""
    if rng.random() < 0.15:
        # The fields of the file's header and of the first page.
        return overwrite_number(content, rng, at=rng.randrange(max(1, min(200, len(content)))), big=True)
    try:
        with closing(sqlite3.connect(":memory:")) as base:
            base.deserialize(content)
            _change(base, rng)
            base.commit()
            return base.serialize()
    except (sqlite3.Error, OverflowError, ValueError, TypeError, AttributeError):
        return havoc(content, rng)


def _change(base: sqlite3.Connection, rng: random.Random) -> None:
    base.text_factory = bytes
    tables = [
        name.decode() for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
    ]
    if not tables:
        return
    table = "messages" if "messages" in tables and rng.random() < 0.6 else rng.choice(tables)
    columns = [row[1].decode() for row in base.execute(f'PRAGMA table_info("{table}")')]
    if rng.random() < 0.15:
        base.executescript(rng.choice(STATEMENTS).format(table=table, column=rng.choice(columns)))
        return
    rows = [row[0] for row in base.execute(f'SELECT rowid FROM "{table}"')]
    if not rows:
        return
    row = rng.choice(rows)
    if table == "messages" and "data" in columns and rng.random() < 0.75:
        (data,) = base.execute("SELECT data FROM messages WHERE rowid = ?", (row,)).fetchone()
        if isinstance(data, bytes):
            base.execute("UPDATE messages SET data = ? WHERE rowid = ?", (mutate_message(data, rng), row))
        return
    if table == "message_definitions" and rng.random() < 0.5:
        (text,) = base.execute(
            "SELECT encoded_message_definition FROM message_definitions WHERE rowid = ?", (row,)
        ).fetchone()
        changed = mutate_definition(text, rng).decode("latin-1")
        base.execute("UPDATE message_definitions SET encoded_message_definition = ? WHERE rowid = ?", (changed, row))
        # Without a digest the definition need not fit it.
        base.execute("UPDATE topics SET type_description_hash = ''")
        return
    column = rng.choice(columns)
    (old,) = base.execute(f'SELECT "{column}" FROM "{table}" WHERE rowid = ?', (row,)).fetchone()
    value = havoc(old, rng).decode("latin-1") if isinstance(old, bytes) and rng.random() < 0.4 else rng.choice(VALUES)
    base.execute(f'UPDATE OR REPLACE "{table}" SET "{column}" = ? WHERE rowid = ?', (value, row))
