// Of several requests of one kind only the newest is sent, when the one before has been answered.
export class Latest {
  constructor(ask, onError) { this.ask = ask; this.onError = onError; this.waiting = new Map(); this.busy = new Set(); }

  // `use` gets the answer, `done` is called after it or after an error; `kind` tells requests of one name apart.
  send(message, use, { kind = message.name, done = () => {} } = {}) {
    if (this.busy.has(kind)) { this.waiting.set(kind, [message, use, { kind, done }]); return; }
    this.busy.add(kind);
    this.ask(message).then((answer) => { this.onError(null); use(answer); }).catch((error) => this.onError(error)).finally(() => {
      done();
      this.busy.delete(kind);
      const next = this.waiting.get(kind);
      this.waiting.delete(kind);
      if (next) this.send(...next);
    });
  }
}
