// ── Drawing ─────────────────────────────────────────────────────────────────────────────────────

const $ = (id) => document.getElementById(id);

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Touches the page only where something changed. */
function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Has these elements in a place, in this order; those that stay are not moved. */
function arrange(place, elements) {
  const focused = place.contains(document.activeElement) ? document.activeElement : null;
  const wanted = new Set(elements);
  for (const child of [...place.children]) if (!wanted.has(child)) child.remove();
  for (const [i, element] of elements.entries()) {
    if (place.children[i] !== element) place.insertBefore(element, place.children[i] ?? null);
  }
  if (focused?.isConnected && focused !== document.activeElement) focused.focus({ preventScroll: true });
}

const cell = (style, ...content) => make("td", style ? { class: style } : {}, ...content);

/** Has rows of these texts in a table; `shape` makes a row, `fill` writes into its cells. */
function fillRows(body, items, shape, fill) {
  while (body.rows.length > items.length) body.lastElementChild.remove();
  for (const [i, item] of items.entries()) {
    if (!body.rows[i]) body.append(shape());
    fill(body.rows[i].cells, item);
  }
}

/** Leads to a place of the page. */
function goTo(place) {
  place.scrollIntoView({ block: "start" });
  place.focus({ preventScroll: true });
}

function svg(tag, attributes = {}) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

