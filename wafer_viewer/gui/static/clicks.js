/* A click during which the drawing below the pointer is replaced: the browser sends none, because the element that was
   pressed is gone when the button is released. The element in its place is clicked instead, if it has the same purpose. */
const MOST_MOTION_PX = 4;
const clickable = at => at?.closest?.('[data-pick]');
/* A button is pressed for its key, whatever its style. */
const purpose = element => (element.getAttribute('role') === 'button'
  ? [element.tagName, element.dataset.pick, element.dataset.k]
  : [element.tagName, element.getAttribute('class')]).join();
let pressed = null;

document.addEventListener('pointerdown', event => {
  const element = event.isPrimary && event.button === 0 ? clickable(event.target) : null;
  pressed = element && { element, purpose: purpose(element), x: event.clientX, y: event.clientY };
}, true);
document.addEventListener('pointerup', event => {
  const before = pressed;
  pressed = null;
  if (!before || before.element.isConnected) return;
  if (Math.hypot(event.clientX - before.x, event.clientY - before.y) > MOST_MOTION_PX) return;
  const now = clickable(document.elementFromPoint(event.clientX, event.clientY));
  if (!now || purpose(now) !== before.purpose) return;
  const { clientX, clientY } = event;
  window.wvClick(now, { clientX, clientY, detail: 1 });
}, true);

/* What has the focus, and is drawn anew, keeps it: its successor has the same purpose. Focus that a press by key took away
   with its button goes to what followed it in its panel, or came before. */
const REACHED = 'a[href], button, input, select, textarea, [role=button], [role=slider]';
const OUT_OF_REACH = ':disabled, [data-disabled], [tabindex="-1"], [aria-hidden=true]';
const TAKEN_MS = 5000;
const reachable = at => at.isConnected && !at.matches(OUT_OF_REACH) && at.getClientRects().length > 0 && !at.closest('[inert]');
let focused = null, following = [], pressedAt = 0;
document.addEventListener('focusin', event => { focused = clickable(event.target); }, true);
document.addEventListener('click', event => { if (event.detail) focused = null; }, true);  // by mouse: the keys are the page's
window.addEventListener('keydown', event => {
  if (event.key !== 'Enter' && event.key !== ' ') return;
  const room = event.target.closest?.('[role=dialog], [data-dock-region], [data-floating-window]') ?? document;
  const all = [...room.querySelectorAll(REACHED)], at = all.indexOf(event.target);
  [following, pressedAt] = [at < 0 ? [] : [...all.slice(at + 1), ...all.slice(0, at).reverse()], Date.now()];
}, true);
const keepFocus = () => {
  /* A button that was switched off has the focus until the next picture, and loses it then without an event. */
  const active = document.activeElement;
  if (active !== document.body && !active.matches(':disabled')) return;
  const before = focused && !focused.isConnected ? focused : null;
  focused = null;
  const same = at => at.dataset.k === before.dataset.k && at.tagName === before.tagName && reachable(at);
  const successor = before && [...document.querySelectorAll(`[data-pick="${before.dataset.pick}"]`)].find(same);
  const next = Date.now() - pressedAt < TAKEN_MS ? following.find(reachable) : null;
  (successor ?? next)?.focus({ preventScroll: !!successor });
};
new MutationObserver(keepFocus).observe(document.body, {
  childList: true, subtree: true, attributes: true, attributeFilter: ['disabled', 'data-disabled'],
});
