"""The links between frames as a forest: a frame has one parent at most, and any can be made the top of its tree."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gridtrack.recordings.frames.chains import Chain, Link


class Forest:
    """Links by their child."""

    def __init__(self, links: Iterable[Link] = ()) -> None:
        self._links = {link.child: link for link in links}

    def __contains__(self, child: str) -> bool:
        """Whether a frame has a parent."""
        return child in self._links

    @property
    def links(self) -> list[Link]:
        """All links."""
        return list(self._links.values())

    @property
    def frames(self) -> list[str]:
        """All frames, children before parents in each link."""
        return list(dict.fromkeys(frame for link in self.links for frame in (link.child, link.parent)))

    def put(self, link: Link) -> None:
        """Add a link in place of the one that its child has."""
        self._links[link.child] = link

    def path(self, frame: str) -> list[str]:
        """The frames from one up; in a cycle the last is one of those before it."""
        path, seen = [frame], {frame}
        while (link := self._links.get(path[-1])) is not None:
            path.append(link.parent)
            if link.parent in seen:
                break
            seen.add(link.parent)
        return path

    def rigid_path(self, frame: str) -> list[str]:
        """The frames from one up to the topmost one that it does not move in."""
        path = [frame]
        for above in self.path(frame)[1:]:
            if self._links[path[-1]].moves:
                break
            path.append(above)
        return path

    def top(self, frame: str) -> str:
        """The topmost frame of the tree of a frame."""
        return self.path(frame)[-1]

    def moves(self, frame: str) -> bool:
        """Whether a link above a frame moves."""
        return self.moving_above(frame) is not None

    def moving_above(self, frame: str) -> Link | None:
        """The lowest link above a frame that moves."""
        above = (self._links[one] for one in self.path(frame) if one in self)
        return next((link for link in above if link.moves), None)

    def chain(self, world: str, sensor: str) -> Chain:
        """The links from `world` down to the frame of a sensor, which is below it."""
        path = self.path(sensor)
        below = path[: path.index(world)]
        return Chain(world, tuple(self._links[child] for child in reversed(below)))

    def turn(self, top: str) -> None:
        """Make a frame the top of its tree: the links above it are followed the other way."""
        for link in [self._links.pop(child) for child in self.path(top)[:-1]]:
            self.put(link.inverse())

    def join(self, link: Link) -> None:
        """Put a link where its child may have a parent: in another tree than that of the link's parent, or below it.

        In another tree the child becomes the top of its own first; above it, the parent does: no cycle is made.
        """
        if link.child in self.path(link.parent)[1:]:
            self.turn(link.parent)
        elif self.top(link.child) != self.top(link.parent):
            self.turn(link.child)
        self.put(link)


def in_common(paths: Sequence[Sequence[str]]) -> list[str]:
    """The frames of the first path that all the others hold, in its order."""
    others = [set(path) for path in paths[1:]]
    return [frame for frame in (paths[0] if paths else ()) if all(frame in other for other in others)]
