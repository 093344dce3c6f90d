"""Control handover on one page: note of an observer or an operator, requests for control, and answers."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial

import viser
from markupsafe import Markup

from wafer_viewer.gui.dialogs.dialog import WAIT_S, Confirm, Dialog
from wafer_viewer.gui.elements.elements import Elements, Html, Text
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.page.page import Page, restrictions
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.roles import rule
from wafer_viewer.session.state.snapshot import Browser, ControlState, Snapshot

_GREY = "{opacity:.5;pointer-events:none}"
_WATCHING = html.style_sheet(f"[{html.NEEDS_CONTROL}]{_GREY}")
_OPERATING = html.style_sheet(f"[{html.NEEDS_ENGINEER}]{_GREY}")
_MASKED = Markup('<div class="wv-masked"></div>') + html.style_sheet(
    "div:has(>.wv-masked)+div input{-webkit-text-security:disc}"
)
"""Mark before a text field whose letters are not shown; viser has no field for passwords."""
NOT_HANDED_OVER = "Control was not handed over"
NAME_HINT = "Shown to the other browsers"


def control_strip(here: Here[None]) -> Elements:
    """Return the note above the panel of an observer or an operator, with the style of what cannot be used."""
    control, key = here.snapshot.control, here.page.browser.key
    return [Html(_strip(control, key) if any(restrictions(control, key)) else "")]


CONTROL_PICKS: Picks[None] = {
    "hands": lambda here, _: control_dialog(here.page),
    "hands-over": lambda here, to: hand_over(here.page, to),
    "hands-keep": lambda here, _: here.page.session.control.keep(here.page.browser.key),
    "hands-ask": lambda here, _: ask(here.page),
    "sign-in": lambda here, _: sign_in_dialog(here.page),
    "sign-out": lambda here, _: sign_out(here.page),
}


class ControlNews:
    """News of who holds the controls."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._control = ControlState()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Tell what has changed."""
        self._tell(self._control, snapshot.control)
        self._control = snapshot.control

    def _tell(self, before: ControlState, now: ControlState) -> None:
        page, key = self._page, self._page.browser.key
        if before.holder is not None and before.holder != now.holder and before.browser(key) is not None:
            if now.holds(key):
                page.say("You hold the controls now", "The others watch.")
            elif before.holds(key):
                page.say(
                    f"{now.name_of(now.holder)} holds the controls now",
                    "You are watching. A running scan continues.",
                    "attention",
                )
        if now.refused == key and before.refused != key:
            page.say(f"{now.name_of(now.holder)} keeps the controls", "Ask again later.", "attention")


def control_question(snapshot: Snapshot, key: str) -> Markup:
    """Return the question to the holder as long as another browser asks for the controls; else empty."""
    control = snapshot.control
    return _question(control) if control.holds(key) and control.requester is not None else Markup()


def ask(page: Page) -> None:
    """Request control; a browser without a name enters one first."""
    if page.browser.name:
        page.ask(NOT_HANDED_OVER, page.session.control.ask(page.browser.key))
    else:
        control_dialog(page)


def hand_over(page: Page, to: str) -> None:
    """Hand control over to the browser with a public id."""
    browsers = page.session.snapshot.control.browsers
    key = next((browser.key for browser in browsers if browser.public_id == to), "")
    page.ask(NOT_HANDED_OVER, page.session.control.hand_over(page.browser.key, key))


@dataclass(frozen=True, slots=True)
class _SignIn:
    name: str = ""
    password: str = ""


def sign_in_dialog(page: Page) -> None:
    """Open the dialog in which a listed person signs in at this browser."""

    def contents(here: Dialog[_SignIn]) -> Elements:
        password_hint = "Password of the listed person, not of the page"
        return [
            Text("Your name", here.own.name, partial(here.put, "name"), NAME_HINT),
            Html(_MASKED, padded=False),
            Text("Password", here.own.password, partial(here.put, "password"), password_hint),
        ]

    def done(here: Dialog[_SignIn]) -> None:
        key, own = page.browser.key, here.own
        person = page.session.control.sign_in(key, own.name, own.password).result(WAIT_S)
        page.say(f"{person.name} is signed in", f"As {person.role}.")
        if page.session.snapshot.control.holder is None:
            page.ask(NOT_HANDED_OVER, page.session.control.ask(key))

    below = "Operators run released jobs; engineers may do everything. The audit log names who was signed in."
    answer = Confirm("Sign in", viser.Icon.LOGIN, done, "Sign-in failed", commands=False)
    Dialog(page, "Sign in", below, answer, _SignIn(), contents)


def sign_out(page: Page) -> None:
    """Sign out the person at this browser."""
    page.ask("Sign-out failed", page.session.control.sign_out(page.browser.key))


def control_dialog(page: Page) -> None:
    """Open the dialog of connected browsers: holder of the controls, name of this browser, request for control."""
    control, key = page.session.snapshot.control, page.browser.key
    holds = control.holds(key)

    def contents(here: Dialog[str]) -> Elements:
        now = here.snapshot.control
        name = Text("Your name", here.own, here.hold, NAME_HINT)
        return [Html(_people(now, key) + _signing(now, key)), None if now.is_signed_in(key) else name]

    def done(here: Dialog[str]) -> None:
        _call(page, here.own)
        if not holds:
            page.ask(NOT_HANDED_OVER, page.session.control.ask(key))

    def pass_on(here: Dialog[str], to: str) -> None:
        here.close()
        _call(page, here.own)
        hand_over(page, to)

    def sign(here: Dialog[str], way: str) -> None:
        here.close()
        (sign_in_dialog if way == "in" else sign_out)(page)

    below = "One browser holds the controls; all may look, measure and stop all motion."
    if holds:
        answer = Confirm("Done", viser.Icon.CHECK, done, "The name was not changed", commands=False)
    else:
        verb = "Ask for control" if control.holder else "Take control"
        answer = Confirm(verb, viser.Icon.HAND_STOP, done, NOT_HANDED_OVER, commands=False)
    picks = {"hands-to": pass_on, "to-sign": sign}
    Dialog(page, "Connected browsers", below, answer, control.name_of(key), contents, picks)


def _call(page: Page, name: str) -> None:
    """Rename this browser and store the name in it."""
    name = " ".join(name.split())
    if name and name != page.session.snapshot.control.name_of(page.browser.key):
        page.ask("The name was not changed", page.session.control.rename(page.browser.key, name))
    if name:
        page.remember(replace(page.browser, name=name))


def _people(control: ControlState, key: str) -> Markup:
    def line(browser: Browser) -> Markup:
        me = " (this browser)" if browser.key == key else ""
        role = f", {browser.role}" if browser.role else ""
        return html.row([browser.name + role + me, _state(control, browser, key)], " n")

    return html.table([], [line(browser) for browser in control.browsers], " n") + Markup(
        '<div style="height:8px"></div>'
    )


def _state(control: ControlState, browser: Browser, key: str) -> Markup:
    if control.holds(browser.key):
        return Markup("<b>holds the controls</b>")
    if not browser.present:
        return Markup('<span class="dim">disconnected</span>')
    if control.holds(key):
        return html.link("Hand over", "hands-to", browser.public_id)
    return Markup('<span class="dim">watches</span>')


def _signing(control: ControlState, key: str) -> Markup:
    """Return the link to sign in or out; empty where nobody is listed."""
    if not control.engineers:
        return Markup()
    way, verb = ("out", "Sign out") if control.is_signed_in(key) else ("in", "Sign in…")
    return Markup('<div style="margin-bottom:8px"><span class="wv-link" {}>{}</span></div>').format(
        html.pick("to-sign", way), verb
    )


def _strip(control: ControlState, key: str) -> Markup:
    """Return the note above the panel of an observer or an operator, and the style of what cannot be used."""
    if not control.holds(key):
        return _watching(control, key) + _WATCHING
    if control.role_of(key) is None:
        link = html.link("Sign in…", "sign-in")
        told = "Sign in to use the controls. Without that you may look, measure and stop all motion."
        return (
            html.note("busy", "Nobody is signed in on this browser.", told, link, html.icon(viser.Icon.USER, 18))
            + _WATCHING
        )
    link = html.link("Sign out", "sign-out")
    title = f"{control.name_of(key)} is signed in as operator."
    changed = "changes plans, jobs, recipes, calibrations and verdicts"
    told = f"Released jobs may be run. {rule(changed, control.engineers)}"
    return html.note("busy", title, told, link, html.icon(viser.Icon.USER, 18)) + _OPERATING


def _watching(control: ControlState, key: str) -> Markup:
    """Return the note above an observer's panel."""
    if control.requester == key:
        end = Markup('<span class="dim">Asked; {} has {:.0f} s.</span>').format(
            control.name_of(control.holder), control.answer_s
        )
    else:
        verb = "Ask for control" if control.holder else "Take control"
        end = html.link(verb, "hands-ask")
    sign = html.icon(viser.Icon.EYE, 18)
    return html.note("busy", control.why_not(key) or "", "You may look, measure and stop all motion.", end, sign)


def _question(control: ControlState) -> Markup:
    """Return the request with its two answers and a bar that runs down until control passes."""
    name = control.name_of(control.requester)
    gone_s = max(0.0, time.time() - control.requested_at)
    requester = control.browser(control.requester)
    over, stay = html.pick("hands-over", requester.public_id if requester else ""), html.pick("hands-keep")
    return Markup(
        '<div class="wv-asked" role="alertdialog" aria-label="{name} asks for the controls">'
        "<b>{name} asks for the controls</b>"
        "<span>Without an answer control passes in {answer_s:.0f} s. A running scan continues.</span>"
        '<div><span class="wv-yes" {over}>Hand over</span><span class="wv-no" {stay}>Keep</span></div>'
        '<i style="animation:wv-drain {answer_s:g}s linear -{gone_s:.1f}s both"></i></div>'
    ).format(name=name, answer_s=control.answer_s, over=over, stay=stay, gone_s=gone_s)
