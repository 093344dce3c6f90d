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

/* What has the focus, and is drawn anew, keeps it: its successor has the same purpose. */
let focused = null;
document.addEventListener('focusin', event => { focused = clickable(event.target); }, true);
new MutationObserver(() => {
  if (!focused || focused.isConnected) return;
  const before = focused;
  focused = null;
  if (document.activeElement !== document.body) return;
  const { pick, k } = before.dataset;
  const same = at => at.dataset.k === k && at.tagName === before.tagName && at.getClientRects().length > 0;
  [...document.querySelectorAll(`[data-pick="${pick}"]`)].find(same)?.focus({ preventScroll: true });
}).observe(document.body, { childList: true, subtree: true });
