"""Landmarks, lines, and what robots saw of them."""

from __future__ import annotations

from tests.fuzz.case import Case, one_file

SIGHTINGS = "stamp,x,y,theta,id,range,bearing\n0.5,1,2,0.1,3,2.5,0.3\n0.5,1,2,0.1,,2.5,\n1.5,1.5,2,0.2,-1,,-0.5\n"


def landmark_maps() -> list[Case]:
    texts = (
        "id,x,y\n3,1.5,2.5\n7,-1,0\n",
        "id,x,y,signature\n3,1.5,2.5,0.5\n7,-1,0,0.25\n",
        "# map\nid, x, y, type\n3, 1.5, 2.5, 0\n\n7, -1, 0, 2\n",
        "id,x,y,signature_1,signature_2\n3,1.5,2.5,0.5,1\n7,-1,0,0.25,2\n",
    )
    return [one_file("l.csv", text) for text in texts]


def line_maps() -> list[Case]:
    return [
        one_file("l.csv", "id,rho,alpha\n1,2.5,0.3\n2,-1,3.0\n"),
        one_file("l.csv", "id,x1,y1,x2,y2\n1,0,0,1,1\n2,3,0,3,5\n"),
    ]


def sightings() -> list[Case]:
    """A CSV file of sightings; the map beside it stays as it is."""
    return [Case({"s.csv": SIGHTINGS.encode(), "l.csv": b"id,x,y\n3,1.5,2.5\n"}, "s.csv", frozenset(["l.csv"]))]
