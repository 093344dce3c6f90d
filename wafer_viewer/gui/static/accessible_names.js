/* Accessible names: viser draws a label beside its input and ties the two together for some inputs only. Every input
   in the row of a label gets the label as its name; a field that may be left empty says so in grey: `FACTS.optional`
   holds their labels with these words, unless `data-states` of an element names the label, with the value that holds
   while it is empty and its tone. */
const INPUTS = 'input:not([type=hidden]), textarea, select, [role=slider], [role=combobox], [role=switch]';
const HIDDEN = 'div:has(>.wv-picks)+div input, div:has(>.wv-tells)+div input';
const set = (at, name, value) => { if (at.getAttribute(name) !== value) at.setAttribute(name, value); };
const nameAll = () => {
  const stated = Object.fromEntries([...document.querySelectorAll('[data-states]')].map(at => [at.dataset.states, at.dataset]));
  for (const at of document.querySelectorAll(HIDDEN)) { set(at, 'aria-hidden', 'true'); set(at, 'tabindex', '-1'); }
  for (const at of document.querySelectorAll('input.mantine-Spotlight-search')) set(at, 'aria-label', 'Search the commands');
  for (const label of document.querySelectorAll('label[for]')) {
    const text = label.textContent.trim(), row = label.closest('.mantine-Flex-root');
    if (!text || !row) continue;
    const inputs = [...row.querySelectorAll(INPUTS)].filter(at => !at.matches('[aria-hidden=true]'));
    const typed = inputs.filter(at => at.getAttribute('role') !== 'slider');
    inputs.forEach(at => {
      const n = Math.max(0, typed.indexOf(at)), tied = n === 0 && at.id === label.htmlFor;
      if (!tied) set(at, 'aria-label', n === 0 ? text : typed.length === 2 ? `${text}, second` : `${text}, ${n + 1}`);
      if (inputs.length === 1 && FACTS.optional[text]) set(at, 'placeholder', stated[text]?.value || FACTS.optional[text]);
      at.toggleAttribute('data-stated', Boolean(stated[text]?.value));
      if (stated[text] || at.dataset.tone) at.dataset.tone = stated[text]?.tone ?? '';
    });
  }
  /* In a narrow window viser stacks all panels and folds them: header and status bar stay in reach. */
  for (const at of document.querySelectorAll('.mantine-Tabs-root > :is([inert], [aria-hidden=true]):has(.wv-frame)')) {
    at.inert = false;
    at.removeAttribute('aria-hidden');
  }
};
let due = 0;
new MutationObserver(() => { due = due || setTimeout(() => { due = 0; nameAll(); }, 60); })
  .observe(document.body, { childList: true, subtree: true, attributes: true, attributeFilter: ['inert', 'aria-hidden'] });
nameAll();
