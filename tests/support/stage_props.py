"""A browser that is not present: records what is put on its stage, and answers for its camera."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np


class Node:
    """One node of the scene; attributes set on it are kept."""

    def __init__(self, scene: RecordingScene, name: str, kind: str, made_of: dict[str, Any]) -> None:
        self.__dict__.update(made_of)
        self.name, self.kind, self._scene = name, kind, scene
        self.dragged: list[Callable[..., Any]] = []

    def remove(self) -> None:
        self._scene.nodes.pop(self.name)
        self._scene.log.append(("remove", self.name))

    def on_drag(self, button: str) -> Callable[..., Any]:
        return self.dragged.append


class RecordingScene:
    """Stands for ``client.scene``: any add_... makes a node."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}
        self.log: list[tuple[str, str]] = []
        self.clicked: list[Callable[..., Any]] = []

    def __getattr__(self, verb: str) -> Callable[..., Node]:
        if not verb.startswith("add_"):
            raise AttributeError(verb)

        def add(name: str, *args: Any, **kwargs: Any) -> Node:
            self.nodes[name] = Node(self, name, verb.removeprefix("add_"), {"args": args, **kwargs})
            self.log.append(("add", name))
            return self.nodes[name]

        return add

    def on_click(self) -> Callable[..., Any]:
        return self.clicked.append

    def names(self, part: str) -> list[str]:
        return [name for name in self.nodes if part in name]


class Camera:
    """Stands for ``client.camera``."""

    def __init__(self) -> None:
        self.position, self.look_at = np.array([0.0, -3.0, 4.0]), np.zeros(3)
        self.up_direction, self.fov, self.near = (0.0, 0.0, 1.0), 0.5, 0.01
        self.image_width, self.image_height = 900, 850
        self.moved: list[Callable[..., Any]] = []

    def on_update(self, callback: Callable[..., Any]) -> None:
        self.moved.append(callback)


class Storage:
    """Stands for ``client.local_storage``: there is nothing in it, and it answers at once."""

    def get_item(self, key: str) -> str | None:
        return None


class Browser:
    """Stands for viser's client handle."""

    def __init__(self) -> None:
        self.scene, self.camera, self.local_storage = RecordingScene(), Camera(), Storage()

    @contextlib.contextmanager
    def atomic(self) -> Iterator[None]:
        yield

    def flush(self) -> None:
        """Nothing is buffered."""
