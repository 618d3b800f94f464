// The page at /api: every route of /openapi.json, with what it takes and answers, and a button to try it. Text from
// the document is only ever set as text.

const METHODS = ['get', 'put', 'post', 'patch', 'delete'];
// More of an answer is not shown.
const MAX_SHOWN = 20000;

const make = (name, properties = {}, ...children) => {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
};

// A schema in a few words; a named one once with its fields.
const words = (schema, schemas, depth = 0) => {
  if (!schema) return '';
  if (schema.$ref) {
    const name = schema.$ref.split('/').pop();
    return depth ? name : `${name} ${words(schemas[name], schemas, 1)}`;
  }
  for (const [key, sign] of [['oneOf', ' | '], ['anyOf', ' | '], ['allOf', ' & ']]) {
    if (schema[key]) return schema[key].map((one) => words(one, schemas, depth + 1)).join(sign);
  }
  if (schema.enum) return schema.enum.map((value) => JSON.stringify(value)).join(' | ');
  if (schema.properties) {
    const field = ([name, value]) => {
      const text = `${name}: ${words(value, schemas, depth + 1)}`;
      return value.description && depth < 2 ? `${text}  // ${value.description}` : text;
    };
    return `{\n${Object.entries(schema.properties).map((entry) => `  ${field(entry)}`).join('\n')}\n}`;
  }
  if (schema.items) return `[${words(schema.items, schemas, depth + 1)}]`;
  return [schema.type ?? 'any'].flat().join(' | ') + (schema.format ? ` (${schema.format})` : '');
};

const table = (head, rows) =>
  make('table', {}, make('tr', {}, ...head.map((text) => make('th', { textContent: text }))), ...rows);

const row = (...cells) => make('tr', {}, ...cells.map((cell) => make('td', {}, cell)));

// What a route is asked with, and the button that asks.
const trial = (method, path, operation) => {
  const parameters = (operation.parameters ?? []).map((parameter) => {
    const input = make('input', { ariaLabel: parameter.name, required: parameter.required });
    return { ...parameter, input };
  });
  const rows = parameters.map(({ name, in: place, required, description, schema, input }) =>
    row(make('code', { textContent: name }), `${description ?? ''} ${words(schema, {}, 1)}`,
      required ? `in the ${place}, needed` : `in the ${place}`, input));
  const bodies = Object.keys(operation.requestBody?.content ?? {});
  const body = bodies.includes('application/json') ? make('textarea', { ariaLabel: 'body' }) : null;
  const answer = make('pre', { hidden: true });
  const send = async () => {
    let url = path;
    const query = new URLSearchParams();
    for (const { name, in: place, input } of parameters) {
      if (place === 'path') url = url.replace(`{${name}}`, encodeURIComponent(input.value));
      else if (place === 'query' && input.value) query.set(name, input.value);
    }
    const headers = {};
    const token = document.getElementById('token').value;
    if (token) headers.authorization = `Bearer ${token}`;
    if (body?.value) headers['content-type'] = 'application/json';
    answer.hidden = false;
    answer.textContent = '…';
    try {
      const address = query.size ? `${url}?${query}` : url;
      const response = await fetch(address, { method: method.toUpperCase(), headers, body: body?.value || undefined });
      const type = response.headers.get('content-type') ?? '';
      const isText = /json|text|xml/.test(type) && !type.includes('event-stream');
      const text = isText ? await response.text() : `(${type || 'nothing'})`;
      if (!isText) await response.body?.cancel();
      answer.textContent = `${response.status} ${response.statusText}\n\n${text.slice(0, MAX_SHOWN)}`;
    } catch (error) {
      answer.textContent = String(error);
    }
  };
  // A stream and events do not end.
  const canTry = !path.endsWith('/stream') && !path.endsWith('/events') && (!bodies.length || body);
  const parts = rows.length ? [table(['parameter', 'is', '', ''], rows)] : [];
  if (body) parts.push(body);
  if (canTry) parts.push(make('button', { textContent: 'Send', onclick: send }), answer);
  return parts;
};

const route = (method, path, operation, schemas) => {
  const details = make('details', {}, make('summary', {}, make('strong', { textContent: method.toUpperCase() }),
    make('code', { textContent: path }), make('span', { textContent: ` ${operation.summary ?? ''}` })));
  details.addEventListener('toggle', () => {
    if (details.childElementCount > 1) return;
    const answers = Object.entries(operation.responses ?? {}).map(([status, { description, content }]) => {
      const [type, media] = Object.entries(content ?? {})[0] ?? ['', null];
      const isProblem = type === 'application/problem+json';
      return row(status, description ?? '', type, make('pre', { textContent: isProblem ? '' : words(media?.schema, schemas) }));
    });
    const requests = Object.entries(operation.requestBody?.content ?? {}).map(([type, media]) =>
      row(make('code', { textContent: type }), make('pre', { textContent: words(media.schema, schemas) })));
    details.append(make('div', {},
      make('p', { textContent: operation.description ?? '' }),
      ...(requests.length ? [table(['body', ''], requests)] : []),
      ...trial(method, path, operation),
      table(['answer', 'means', 'type', 'holds'], answers)));
  });
  return details;
};

const show = async () => {
  const main = document.getElementById('routes');
  const response = await fetch('/openapi.json');
  const { paths, components } = await response.json();
  const byTag = new Map();
  for (const [path, item] of Object.entries(paths)) {
    for (const method of METHODS.filter((name) => item[name])) {
      const tag = item[method].tags?.[0] ?? 'other';
      if (!byTag.has(tag)) byTag.set(tag, []);
      byTag.get(tag).push(route(method, path, item[method], components?.schemas ?? {}));
    }
  }
  main.replaceChildren(...[...byTag].flatMap(([tag, routes]) => [make('h2', { textContent: tag }), ...routes]));
};

show().catch((error) => {
  document.getElementById('routes').textContent = `The interface cannot be shown: ${error}`;
});
