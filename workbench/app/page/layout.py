"""Page around the stages: navigation, headline, progress, error messages, and callbacks."""

from collections.abc import Callable, Sequence
from typing import Any

from dash import ALL, ClientsideFunction, Dash, Input, Output, State, ctx, dcc, html, no_update
from dash.dependencies import MATCH
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from pendulum_env.formatting import capitalise, typeset
from pendulum_env.lookup import find
from workbench.app import uploads
from workbench.app.card import UNWRAP
from workbench.app.panels import show_job, show_state, show_undo
from workbench.app.parts import Stage, make_aria, make_button, make_panel, typeset_texts
from workbench.app.session import Session, Sessions
from workbench.app.stages import STAGES
from workbench.app.state import NO_RECORDING
from workbench.options import FORMATS

VERSION = Output("version", "data", allow_duplicate=True)


def make_page() -> Component:
    """Make the initial page; callbacks fill it from the session."""
    brand = html.Span("pendulum-ident", className="brand")
    stages = html.Nav(make_navigation(STAGES[0], NO_RECORDING), id="nav", **make_aria(label="Stages"))
    theme = html.Button(
        "◐", type="button", className="theme", title="Light or dark", **make_aria(label="Light or dark")
    )
    story = html.Div(id="story", className="so-far", **make_aria(live="polite"))
    stage = html.Div(id="stage", tabIndex=-1)
    job = html.Div([html.Div(id="job"), make_button("Cancel", "cancel")], className="running")  # the button stays
    return html.Div(
        [
            dcc.Location(id="url", refresh=False),
            dcc.Store(id="session"),  # session id of the tab
            dcc.Store(id="version", data=0),  # version of the session that is drawn; 0 after loading
            dcc.Download(id="download"),
            dcc.Interval(id="poll", interval=300),  # [ms]
            html.A("Skip to the stage", href="#stage", className="skip", id="skip"),
            html.Header(html.Div([brand, stages, theme], className="inner"), className="bar"),
            html.Div("Working …", id="waiting", role="status"),
            html.Main([story, html.Div(id="notice", role="alert"), job, show_upload(), stage], id="main"),
        ]
    )


def show_upload() -> Component:
    """Render the upload; it stays on the page when the stage changes, so that a running upload is not lost."""
    choose = html.Button([html.Strong("Choose recordings"), " or drop them here"], type="button", className="drop")
    about = (
        f"{FORMATS} with time, position and torque; 0 hangs down. The page asks for the meaning of columns with other "
        f"names, unless a {uploads.STUDY} among the files gives it. Add the URDF or MJCF of an arm. To go on from "
        f"earlier work, load its {uploads.STUDY} and {uploads.MODEL}, which the stage Export saves, with the "
        f"recordings; a {uploads.MODEL} alone is another model to start from. Up to {uploads.LARGEST / 1e6:.0f} MB at "
        "once; nothing leaves this computer."
    )
    unwrap = dcc.Checklist([{"label": UNWRAP, "value": "unwrap"}], [], id="unwrap")
    upload = dcc.Upload(choose, id="upload", multiple=True)
    return html.Div(make_panel("Load recordings", upload, html.P(about, className="note"), unwrap), id="files")


def make_navigation(current: Stage, failure: str) -> list[Component]:
    """Make the links to the stages; `current`: current stage, `failure`: reason for a missing model, or empty."""

    def link(stage: Stage) -> Component:
        attributes = make_aria(current="page") if stage is current else {}
        if stage.needs_model and failure:
            attributes |= make_aria(disabled="true", describedby="reason")
        else:
            attributes["href"] = f"#{stage.id}"
        return html.A(stage.title, id=f"to-{stage.id}", **attributes)

    return [*map(link, STAGES), html.Span(capitalise(failure), id="reason", className="note")]


def show(session: Session, stage: Stage) -> list[Component]:
    """Render a stage, or the reason for a missing model that it needs."""
    if stage.needs_model and session.state.failure_reason:
        reason = html.P(f"{capitalise(session.state.failure_reason)}.")
        return [html.Section([reason, html.A("Go to Data", href="#data")], className="panel empty")]
    return stage.show(session)


def connect(app: Dash, sessions: Sessions) -> None:
    """Register the callbacks of the page and of all stages."""
    _connect_page(app, sessions)
    _connect_actions(app, sessions)
    _connect_scripts(app)
    for stage in STAGES:
        if stage.connect is not None:
            stage.connect(app, sessions)


def _connect_page(app: Dash, sessions: Sessions) -> None:
    """Register the callbacks that draw the page and the progress of jobs."""
    # redraw on each change of stage, too: the button that started a job may be gone
    inputs = Input("session", "data"), Input("url", "hash"), Input("version", "data")

    @app.callback(
        *(Output(part, "children") for part in ("nav", "story", "notice", "stage")), Output("files", "hidden"), *inputs
    )
    def draw(id: str | None, hash: str | None, _: int) -> tuple[Any, ...]:
        if id is None:
            raise PreventUpdate
        session = sessions.find_session(id)
        stage = next((stage for stage in STAGES if f"#{stage.id}" == hash), STAGES[0])
        with session.lock:  # wait for running actions; the drawing below is outside the lock
            if ctx.triggered_id == "url":
                session.notice = ""  # the message belongs to another stage
        return (
            make_navigation(stage, session.state.failure_reason),
            typeset_texts([*show_state(session.state), *show_undo(session)]),
            typeset(session.notice),
            typeset_texts(html.Div(show(session, stage), key=stage.id, className=f"stage {stage.id}")),
            stage is not STAGES[0],
        )

    late = {name: show for stage in STAGES for name, show in stage.late.items()}

    @app.callback(Output({"late": MATCH}, "children"), Input({"late": MATCH}, "id"), State("session", "data"))
    def fill(place: dict[str, str], id: str) -> Any:
        """Draw a slow part of a stage."""
        session = sessions.find_session(id)
        if session.state.failure_reason:
            raise PreventUpdate
        return typeset_texts(late[place["late"]](session))

    @app.callback(
        Output("job", "children"),
        VERSION,
        *inputs,
        Input("poll", "n_intervals"),
        prevent_initial_call="initial_duplicate",
    )
    def watch(id: str | None, _: str | None, version: int, __: int) -> tuple[Any, ...]:
        """Draw the progress bar, and send the version if the session has changed."""
        if id is None:
            raise PreventUpdate
        session = sessions.find_session(id)
        with session.lock:
            runs = session.job is not None and session.job.running
            # a page just loaded (version 0) is up to date: it needs the version only after its job has ended
            changed = session.version != version if version else ctx.triggered_id == "poll" and not runs
            return show_job(session), session.version if changed else no_update


def _connect_actions(app: Dash, sessions: Sessions) -> None:
    """Register the callbacks of buttons, uploads and column choices; a new version redraws the page."""
    actions = {name: do for stage in STAGES for name, do in stage.actions.items()}
    actions |= {"back": lambda session, *_: session.undo(), "again": lambda session, *_: session.undo(is_redo=True)}
    fields = State({"field": ALL}, "value"), State({"field": ALL, "of": ALL}, "value")

    def run_action(session: Session, do: Callable[[], object]) -> int:
        """Run an action by `Session.run_action`, and return the new version."""
        session.run_action(do)
        if (job := session.job) is not None:
            job.over.wait(0.4)  # [s]: short jobs need no progress bar
        return session.version

    @app.callback(
        VERSION, Input({"do": ALL, "of": ALL}, "n_clicks"), *fields, State("session", "data"), prevent_initial_call=True
    )
    def press(*values: Any) -> int:
        session, clicks = sessions.find_session(values[-1]), ctx.triggered[0]["value"]
        if not clicks:  # new buttons trigger the callback, too
            raise PreventUpdate
        button = ctx.triggered_id
        if button["do"] == "cancel":  # also during a job
            session.cancel()
            return session.version
        form = collect_form(ctx.states_list)
        return run_action(session, lambda: find("action", button["do"], actions)(session, button["of"], form))

    @app.callback(
        VERSION,
        Output("upload", "contents"),
        Input("upload", "contents"),
        State("upload", "filename"),
        State("unwrap", "value"),
        State("session", "data"),
        prevent_initial_call=True,
    )
    def take(contents: list[str] | None, names: list[str], unwrap: list[str], id: str) -> tuple[int, None]:
        if not contents:
            raise PreventUpdate
        session, files = sessions.find_session(id), list(zip(names, contents, strict=True))
        # None: the same file can be uploaded again
        return run_action(session, lambda: session.load_uploads(files, bool(unwrap))), None

    @app.callback(
        VERSION,
        Input({"field": "role", "of": ALL}, "value"),
        Input({"field": "unit", "of": ALL}, "value"),
        fields[1],
        State("session", "data"),
        prevent_initial_call=True,
    )
    def choose(*values: Any) -> int:
        session = sessions.find_session(values[-1])
        with session.lock:
            form, card = collect_form(ctx.states_list), next(iter(session.cards), None)
            if (
                card is None
                or len(values[0]) != len(card.choices)
                or card.has_same_roles(filled_card := card.fill_form(form))
            ):
                raise PreventUpdate  # new controls trigger the callback, too
            session.run_action(lambda: setattr(session, "cards", (filled_card, *session.cards[1:])))
            return session.version


def collect_form(groups: Sequence[Any]) -> dict[str, Any]:
    """Return the values of the page's controls by name, `field` or `field:k`."""
    controls = [control for group in groups if isinstance(group, list) for control in group]
    return {":".join(str(part) for part in control["id"].values()): control.get("value") for control in controls}


def _connect_scripts(app: Dash) -> None:
    """Register the callbacks in assets/app.js."""

    def register_script(function: str, output: Output, *inputs: Input | State) -> None:
        app.clientside_callback(ClientsideFunction("app", function), output, *inputs)  # type: ignore[no-untyped-call]

    text = {"kind": "fragment", "of": MATCH}
    register_script("session", Output("session", "data"), Input("url", "pathname"))
    register_script(
        "fragment", Output(text, "title"), Input({"kind": "markup", "of": MATCH}, "data"), State(text, "id")
    )
    register_script("reveal", Output("nav", "title"), Input("nav", "children"))
