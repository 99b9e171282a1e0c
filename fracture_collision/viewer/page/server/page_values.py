"""Values of controls that browsers send, checked before viser keeps them and passes them on to all browsers.

A browser keeps to a control's range and options; another client need not. viser stores any value, and any other
property of the control. A number outside its range may end the node that calculates with it, and an integer that no
message can carry ends the connection of every browser. So viser's handler is replaced by one that passes on values
only, clamped to their control's range (written for viser 1.1).
"""

from __future__ import annotations

from typing import Any

import viser
from viser import _messages as messages


def keep_values_in_range(server: viser.ViserServer) -> None:
    """From now on drop values that are not of their control's type and options, and clamp numbers to its range."""
    gui: Any = server.gui
    pass_on = gui._handle_gui_updates

    async def check(client_id: int, message: Any) -> None:
        knob = gui._gui_input_handle_from_uuid.get(message.uuid)
        value = None if knob is None or not isinstance(message.updates, dict) else _valid(knob, message.updates)
        if value is not None:
            await pass_on(client_id, messages.GuiUpdateMessage(message.uuid, {"value": value}))

    gui._websock_interface.unregister_handler(messages.GuiUpdateMessage, pass_on)
    gui._websock_interface.register_handler(messages.GuiUpdateMessage, check)


def _valid(knob: Any, updates: dict[str, Any]) -> bool | int | float | str | None:
    """The value for `knob`; None if it is none."""
    present, value, props = knob._impl.value, updates.get("value"), knob._impl.props
    if isinstance(present, bool):
        return value if isinstance(value, bool) else None
    if isinstance(present, int | float):
        is_number = isinstance(value, int | float) and not isinstance(value, bool) and value == value
        return min(max(value, props.min), props.max) if is_number else None
    return value if isinstance(value, str) and value in props.options else None
