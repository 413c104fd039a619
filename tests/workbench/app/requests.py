"""The app without a browser."""

from __future__ import annotations

import json
from typing import Any

from workbench.app.page.server import make_app


class Page:
    """The app without a browser."""

    ID = "f" * 32

    def __init__(self) -> None:
        app, self.sessions = make_app()
        self.client = app.server.test_client()
        self.client.get("/_dash-layout")
        self.callbacks = self.client.get("/_dash-dependencies").get_json()
        self.session = self.sessions.find_session(self.ID)

    def close(self) -> None:
        self.sessions.close()

    def ask(self, callback: dict[str, Any], values: list[Any]) -> int:
        """Ask a callback with values for what it depends on; returns the status."""

        def named(id: str) -> Any:
            return json.loads(id) if id.startswith("{") else id

        def part(of: dict[str, Any]) -> Any:
            id, value = named(of["id"]), values.pop() if values and of["id"] != "session" else None
            many = isinstance(id, dict) and ["ALL"] in id.values()
            if isinstance(id, dict):
                id = {key: "run.csv" if isinstance(value, list) else value for key, value in id.items()}
            one = {"id": id, "property": of["property"], "value": self.ID if id == "session" else value}
            return [one] if many else one

        def output(text: str) -> dict[str, Any]:
            id, _, name = text.rpartition(".")
            return {"id": named(id), "property": name.partition("@")[0]}

        told, inputs = callback["output"], [part(one) for one in callback["inputs"]]
        first = inputs[0][0] if isinstance(inputs[0], list) else inputs[0]
        name = first["id"] if isinstance(first["id"], str) else json.dumps(first["id"], separators=(",", ":"))
        ask = {
            "output": told,
            "outputs": [output(one) for one in told[2:-2].split("...")] if told.startswith("..") else output(told),
            "inputs": inputs,
            "state": [part(one) for one in callback.get("state", [])],
            "changedPropIds": [f"{name}.{first['property']}"],
        }
        return self.client.post("/_dash-update-component", json=ask).status_code
