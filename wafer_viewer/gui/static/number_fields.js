/* Number fields take what is typed as it stands. Those of viser (react-number-format in Mantine's NumberInput) put the
   caret behind a sign, read a second minus as a change of sign, drop the other characters for a minus, and take the
   digits after a decimal point that they refuse: −12 typed over −6 became 126 or 12, and 12.5 became 125. */
const isNumberField = at => at.matches?.('.mantine-NumberInput-input');
const UNFINISHED = /^-?\d*\.?\d*$/;
const NUMBER = /^([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)(.*)$/i;
const plain = text => text.replace(/[\u2010-\u2013\u2212\ufe63\uff0d]/g, '-').replace(',', '.');
const setValue = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
const put = (at, value, caret) => {
  setValue.call(at, value);
  at.setSelectionRange(caret, caret);
  at.dispatchEvent(new InputEvent('input', { bubbles: true, inputType: 'insertText' }));
};

/* A number is selected with its sign, wherever it is clicked twice. The timer comes after that of the first click, which
   moves the caret behind the sign. */
window.addEventListener('mousedown', event => {
  const at = event.target;
  if (event.detail < 2 || event.button !== 0 || !isNumberField(at)) return;
  event.preventDefault();
  at.select();
  setTimeout(() => { if (document.activeElement === at) at.select(); });
}, true);
const SIGNED = /(?<![^\s,;×(])[-+\u2212]?\d+(?:[.,]\d+)?/g;
document.addEventListener('dblclick', event => {
  const at = event.target;
  if (!at.matches?.('input.mantine-TextInput-input')) return;
  const start = at.selectionStart, end = start + at.value.slice(start, at.selectionEnd).trimEnd().length;
  for (const { index, 0: number } of at.value.matchAll(SIGNED)) {
    if (index <= start && end <= index + number.length) at.setSelectionRange(index, index + number.length);
  }
});

/* The text as it would stand after an insertion, with one sign; nothing that cannot become a number is inserted. */
let refused = null; // the field whose decimal point was refused, and its text
const insert = (at, text) => {
  const before = at.value.slice(0, at.selectionStart), after = at.value.slice(at.selectionEnd);
  const value = `${before}${text}${after}`.replace(/^--/, '-');
  if (!UNFINISHED.test(value)) return;
  put(at, value, Math.max(value.length - after.length, value[0] === '-' ? 1 : 0));
  if (text.includes('.') && !at.value.includes('.')) refused = { at, value: at.value };
};
window.addEventListener('beforeinput', event => {
  const { target: at, data } = event;
  if (!isNumberField(at) || data === null || !event.cancelable) return;
  event.preventDefault();
  if (refused?.at === at && refused.value === at.value) return;
  refused = null;
  insert(at, plain(data));
}, true);

/* A pasted number may have spaces between its thousands, an exponent, and the unit of the field. */
const unitOf = at => at.labels?.[0]?.textContent.split(', ').pop() ?? '';
const numberIn = (text, unit) => {
  const [, number, rest] = NUMBER.exec(plain(text).replace(/\s/g, '')) ?? [];
  if (number === undefined || (rest && rest.replace(/^(\u03bc|u)(?=[ms]$)/, 'µ') !== unit)) return null;
  return /e/i.test(number) ? Number(number).toFixed(9).replace(/\.?0+$/, '') : number.replace('+', '');
};
window.addEventListener('paste', event => {
  const at = event.target;
  if (!isNumberField(at)) return;
  event.preventDefault();
  event.stopImmediatePropagation();
  const number = numberIn(event.clipboardData.getData('text'), unitOf(at));
  if (number !== null) insert(at, number);
}, true);

/* Keys: Delete in front of a sign deletes it; a field that is left without a digit shows its number again. */
let entered = null;
window.addEventListener('focusin', event => {
  if (isNumberField(event.target)) entered = { at: event.target, value: event.target.value };
});
const restore = () => {
  const { at, value } = entered ?? {};
  if (at && at === document.activeElement && at.value !== value && !/\d/.test(at.value)) put(at, value, value.length);
};
window.addEventListener('keydown', event => {
  const at = event.target;
  if (!isNumberField(at)) return;
  if (event.key === 'Delete' && at.selectionEnd === 0 && at.value[0] === '-') at.setSelectionRange(0, 1);
  if (['Tab', 'Enter', 'Escape'].includes(event.key)) restore();
}, true);
window.addEventListener('mousedown', event => { if (event.target !== entered?.at) restore(); }, true);
