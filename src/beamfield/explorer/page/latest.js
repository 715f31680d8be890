// Of several requests of one kind only the newest is sent, when the one before has been answered.

const SHOWN_MS = 8000; // how long an error is shown that does not happen again

export class Latest {
  // `onTrouble` gets the text of the errors there are, "" for none.
  constructor(ask, onTrouble) { Object.assign(this, { ask, onTrouble, waiting: new Map(), busy: new Set(), errors: new Map() }); }

  // `use` gets the answer, `done` is called after it or after an error; `kind` tells requests of one name apart, of
  // which one is sent every so many milliseconds at most.
  send(message, use, { kind = message.name, done = () => {}, every = 0 } = {}) {
    if (this.busy.has(kind)) { this.waiting.set(kind, [message, use, { kind, done, every }]); return; }
    this.busy.add(kind);
    const sent = performance.now();
    this.ask(message).then((answer) => { this.note(kind, null); use(answer); }).catch((error) => this.note(kind, error.message)).finally(() => {
      done();
      const left = every - (performance.now() - sent);
      if (left > 0) setTimeout(() => this.next(kind), left); else this.next(kind);
    });
  }

  next(kind) {
    const next = this.waiting.get(kind);
    this.busy.delete(kind);
    this.waiting.delete(kind);
    if (next) this.send(...next);
  }

  note(kind, text) {
    if (text === null) this.errors.delete(kind); else this.errors.set(kind, text);
    this.onTrouble([...new Set(this.errors.values())].join("; "));
    if (text !== null) setTimeout(() => { if (this.errors.get(kind) === text) this.note(kind, null); }, SHOWN_MS);
  }
}
