// The connection to the server of this page: answers under their numbers, events by their names,
// and a confirmation of every update, without which no further one comes.

const RETRY_MS = 700;
const ANSWER_MS = 8000;

export class Connection extends EventTarget {
  #socket = null;
  #next = 1;
  #waiting = new Map();
  isUp = false;

  constructor() {
    super();
    this.#connect();
  }

  #connect() {
    const socket = new WebSocket(`ws://${location.host}/machine`, "taktil.page.v1");
    this.#socket = socket;
    socket.onopen = () => {
      this.isUp = true;
      this.#tell("open");
    };
    socket.onmessage = (message) => this.#take(message.data);
    socket.onclose = () => {
      if (this.isUp) {
        this.isUp = false;
        this.#tell("closed");
      }
      for (const { resolve, timer } of this.#waiting.values()) {
        clearTimeout(timer);
        resolve({ outcome: "error", text: "the connection is gone" });
      }
      this.#waiting.clear();
      setTimeout(() => this.#connect(), RETRY_MS);
    };
  }

  #tell(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  #take(text) {
    let value;
    try {
      value = JSON.parse(text);
    } catch {
      return;
    }
    if (value.event === "update") {
      this.#send({ seen: value.number });
    }
    if (value.event) {
      this.#tell(value.event, value);
      return;
    }
    const waiting = this.#waiting.get(value.id);
    if (waiting) {
      this.#waiting.delete(value.id);
      clearTimeout(waiting.timer);
      waiting.resolve(value);
    }
  }

  #send(message) {
    if (this.#socket?.readyState !== WebSocket.OPEN) {
      return false;
    }
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  /** Sends a request; the promise brings its answer, and never fails. */
  ask(request) {
    const id = this.#next++;
    return new Promise((resolve) => {
      if (!this.#send({ id, ...request })) {
        resolve({ outcome: "error", text: "there is no connection to the page's server" });
        return;
      }
      const timer = setTimeout(() => {
        this.#waiting.delete(id);
        resolve({ outcome: "error", text: "no answer came" });
      }, ANSWER_MS);
      this.#waiting.set(id, { resolve, timer });
    });
  }

  say(words) {
    return this.ask({ say: words });
  }
}
