/* The list of files in a dialog: its rows are chosen with the mouse or the arrows, opened with a double click or Enter;
   Backspace leads to the folder above, Tab completes the path typed. Before keyboard.js. */
const last = selector => [...document.querySelectorAll(`.mantine-Modal-content ${selector}`)].pop();
const setValue = (input, value) => {
  Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(input, value);
  input.dispatchEvent(new Event('input', { bubbles: true }));
};
const rowsOf = list => [...list.querySelectorAll('[role=option]:not([aria-disabled=true])')];
const chosenIn = list => rowsOf(list).filter(row => row.getAttribute('aria-selected') === 'true');
const consume = event => { event.preventDefault(); event.stopImmediatePropagation(); };

const mark = (list, row, how) => {
  const rows = rowsOf(list), several = list.dataset.several;
  const from = rows.indexOf(list.wvAnchor), to = rows.indexOf(row);
  const wanted = how === 'range' && several && from >= 0
    ? rows.slice(Math.min(from, to), Math.max(from, to) + 1)
    : how === 'toggle' && several
      ? (row.getAttribute('aria-selected') === 'true' ? chosenIn(list).filter(r => r !== row) : [...chosenIn(list), row])
      : [row];
  rows.forEach(r => r.setAttribute('aria-selected', wanted.includes(r)));
  if (how !== 'range') list.wvAnchor = row;
  list.setAttribute('aria-activedescendant', row.id);
  row.scrollIntoView({ block: 'nearest' });
  window.wvReport('file-mark', `${list.dataset.of}:${wanted.map(r => r.dataset.n).join(',')}`);
};
const open = (list, row) => window.wvReport('file-open', `${list.dataset.of}:${row.dataset.n}`);

const move = (list, event) => {
  const rows = rowsOf(list);
  if (!rows.length) return;
  const at = rows.indexOf(rows.find(r => r.id === list.getAttribute('aria-activedescendant')));
  const page = Math.max(1, Math.floor(list.clientHeight / rows[0].offsetHeight) - 1);
  const to = {
    ArrowDown: at + 1, ArrowUp: at < 0 ? rows.length - 1 : at - 1, PageDown: at + page, PageUp: at - page,
    Home: 0, End: rows.length - 1,
  }[event.key];
  consume(event);
  mark(list, rows[Math.min(Math.max(to, 0), rows.length - 1)], event.shiftKey ? 'range' : 'one');
};

const complete = (list, event) => {
  const field = event.target, whole = list.dataset.completion || '';
  const typed = field.value.trim(), name = typed.slice(typed.lastIndexOf('/') + 1).toLowerCase();
  const end = whole.endsWith('/') ? whole.slice(0, -1) : whole;
  if (!name || whole.length <= typed.length || !end.slice(end.lastIndexOf('/') + 1).toLowerCase().startsWith(name)) return;
  consume(event);
  setValue(field, whole);
};

document.addEventListener('click', event => {
  const row = event.target.closest?.('.wv-files [role=option]:not([aria-disabled=true])');
  if (!row || event.detail > 1) return;
  mark(row.closest('.wv-files'), row, event.shiftKey ? 'range' : event.ctrlKey || event.metaKey ? 'toggle' : 'one');
});
document.addEventListener('dblclick', event => {
  const row = event.target.closest?.('.wv-files [role=option]:not([aria-disabled=true])');
  if (row) open(row.closest('.wv-files'), row);
});
/* A file that is too large is not read: the browser would send it, and the server close the connection. */
window.addEventListener('change', event => {
  const file = event.target.matches?.('input[type=file]') && event.target.files[0];
  if (!file || file.size <= FACTS.mostUpload) return;
  consume(event);
  event.target.value = '';
  window.wvReport('file-too-large', file.name);
}, true);
/* Files dropped on the page open the import dialog, and are sent there as by its button, one after the other, as soon as
   the dialog says that it waits for them. */
const DROP_MS = 100, DROP_TRIES = 300;
let nDrops = 0;
const hasFile = event => [...event.dataTransfer?.types ?? []].includes('Files');
const send = (files, drop, tries) => {
  const input = document.querySelector(`.mantine-Modal-content:has(.wv-import[data-drop="${drop}"]) input[type=file]`);
  if (!input || input.parentElement.querySelector('button')?.disabled) {
    if (tries || input) setTimeout(() => send(files, drop, input ? DROP_TRIES : tries - 1), DROP_MS);
    return;
  }
  const chosen = new DataTransfer();
  chosen.items.add(files[0]);
  input.files = chosen.files;
  input.dispatchEvent(new Event('change', { bubbles: true }));
  if (files.length > 1) setTimeout(() => send(files.slice(1), drop, 0), DROP_MS);
};
window.addEventListener('dragover', event => { if (hasFile(event)) event.preventDefault(); }, true);
window.addEventListener('drop', event => {
  if (!hasFile(event) || !event.dataTransfer.files.length) return;
  consume(event);
  const files = [...event.dataTransfer.files];
  files.sort((a, b) => a.name.localeCompare(b.name, 'en', { numeric: true }));
  if (files.reduce((sum, file) => sum + file.size, 0) > FACTS.mostUpload) {
    window.wvReport('file-too-large', files.length > 1 ? `A drop of ${files.length} files` : files[0].name);
    return;
  }
  const drop = `${++nDrops}:${files.length}`;
  window.wvReport('import-drop', drop);
  send(files, drop, DROP_TRIES);
}, true);
window.addEventListener('keydown', event => {
  const list = last('.wv-files');
  if (!list || event.isComposing || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target.getAttribute?.('aria-expanded') === 'true') return;
  const inField = event.target.matches?.('.wv-file-field input, div:has(>.wv-file-field) + div input');
  const inList = event.target === list;
  if (!inField && !inList) return;
  const active = rowsOf(list).find(row => row.id === list.getAttribute('aria-activedescendant'));
  if (['ArrowDown', 'ArrowUp', 'PageDown', 'PageUp'].includes(event.key)) move(list, event);
  else if (inList && ['Home', 'End'].includes(event.key)) move(list, event);
  else if (inList && event.key === 'Enter' && active) { consume(event); open(list, active); }
  else if (inList && event.key === 'Backspace') { consume(event); window.wvReport('file-parent', list.dataset.of); }
  else if (inField && event.key === 'Tab' && !event.shiftKey) complete(list, event);
}, true);
