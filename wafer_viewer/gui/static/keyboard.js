/* Keys before viser sees them. viser leaves out every key while an input has the focus, a ticked checkbox too, and its
   dialogs know neither Enter nor Escape. */
const LEFT_ALONE = ['Tab', 'Enter', ' ', 'Shift', 'Control', 'Alt', 'Meta'];
const isTyping = at => at.matches?.('textarea, input:not([type=checkbox], [type=radio], [type=range])');
const last = selector => [...document.querySelectorAll(selector)].pop();
const consume = event => { event.preventDefault(); event.stopImmediatePropagation(); };

/* The main button at the foot of the step's panel lies tens of stops from the first: a full stop goes there, and so does
   the first stop of Tab, which is in sight while it has the focus. */
const mainButton = () => [...document.querySelectorAll('.wv-main')]
  .map(mark => document.getElementById(mark.dataset.button))
  .filter(button => button?.checkVisibility() && !button.matches('[data-disabled], :disabled')).pop();
const skip = Object.assign(document.createElement('button'),
  { type: 'button', className: 'wv-skip', textContent: 'Skip to the main button' });
skip.addEventListener('click', () => mainButton()?.focus());
document.body.prepend(skip);

/* What was typed before Enter may switch the button on, a moment later. */
const press = (marker, tries = 5) => {
  const button = document.getElementById(last(marker)?.dataset.button);
  if (button?.matches(':disabled') && tries) setTimeout(press, 100, marker, tries - 1);
  else button?.click();
};

const inDialog = (event, typing) => {
  if (event.key === 'Escape') { consume(event); press('.mantine-Modal-content .wv-away'); }
  else if (event.key === 'Enter' && typing && event.target.tagName === 'INPUT') {
    consume(event);
    press('.mantine-Modal-content .wv-do');
  } else if (!typing && !LEFT_ALONE.includes(event.key)) event.stopImmediatePropagation();
};

const again = (event, changes) => {
  const copy = new KeyboardEvent('keydown', {
    key: event.key, code: event.code, shiftKey: event.shiftKey, ctrlKey: event.ctrlKey, altKey: event.altKey,
    metaKey: event.metaKey, bubbles: true, cancelable: true, ...changes,
  });
  copy.wvAgain = true;
  event.stopImmediatePropagation();
  document.body.dispatchEvent(copy);
  if (copy.defaultPrevented) event.preventDefault();
};

const elsewhere = event => {
  const plain = !event.ctrlKey && !event.metaKey && !event.altKey;
  if (plain && (event.key === 'F1' || event.key === '?')) {
    consume(event);
    document.querySelector('.wv-keys-sheet')?.click();
  } else if (plain && event.key === '.') {
    consume(event);
    mainButton()?.focus();
  } else if (plain && event.key === 'Enter' && event.target.closest?.('button, [role=button]')) {
    /* It presses what has the focus, and is no key of ours then; with Shift it is ours. */
    if (event.shiftKey) {
      event.preventDefault();
      again(event, {});
    } else {
      consume(event);
      window.wvClick(event.target.closest('button, [role=button]'));
    }
  } else if (plain && event.shiftKey && /^(Digit|Key)/.test(event.code)) {
    /* Shift + 1 types an exclamation mark, and viser's camera asks for no shift: the key alone goes on. */
    again(event, { key: event.code.replace(/^(Digit|Key)/, ''), code: '' });
  } else if (event.target.tagName === 'INPUT' && !LEFT_ALONE.includes(event.key)) again(event, {});
};

window.addEventListener('keydown', event => {
  if (event.wvAgain || event.isComposing || last('.mantine-Spotlight-content')) return;
  if (event.target.getAttribute?.('aria-expanded') === 'true' || event.target.closest?.('.wv-pad')) return;
  const typing = isTyping(event.target);
  if (last('.mantine-Modal-content')) inDialog(event, typing);
  else if (!typing) elsewhere(event);
  else if (['Escape', 'Enter'].includes(event.key) && event.target.tagName === 'INPUT') {
    event.target.blur();
    consume(event);
  }
}, true);

/* The card of the first start comes first. */
window.addEventListener('keydown', event => {
  const card = document.querySelector('.wv-card')?.closest('[data-floating-window]');
  if (event.key !== 'Tab' || event.shiftKey || !card || document.activeElement !== document.body) return;
  event.preventDefault();
  [...card.querySelectorAll('button')].find(button => button.checkVisibility())?.focus();
});

/* A key that moved a slider does nothing else: viser's camera would turn with it. */
const MOVES = ['ArrowUp', 'ArrowDown', 'ArrowLeft', 'ArrowRight', 'PageUp', 'PageDown', 'Home', 'End'];
document.body.addEventListener('keydown', event => {
  if (MOVES.includes(event.key) && event.target.closest?.('[role=slider]')) event.stopPropagation();
});

/* A list that was chosen from with the mouse would keep all keys to itself; another that was opened since keeps them. */
const leave = field => { if (document.activeElement === field) field?.blur(); };
document.addEventListener('click', event => {
  if (event.detail && event.target.closest?.('[role=option]')) setTimeout(leave, 60, document.activeElement);
  /* And a button that was pressed with the mouse would keep Enter. */
  else if (event.detail && event.target.closest?.('button')) document.activeElement?.blur?.();
}, true);
