"""Rewrite the golden answers that changed, and print what changed: ``python -m tests.golden``."""

import sys

from tests.golden.answers import FOLDER, Conversation, differences, file_of, pretty, read, services
from tests.golden.requests import kept_requests

SHOWN = 12


def main() -> int:
    """Ask, compare, write; answers that agree within the tolerance are left as they are."""
    FOLDER.mkdir(exist_ok=True)
    with services() as clients:
        conversation = Conversation(clients)
        got = {one.name: conversation.answer(one) for one in kept_requests()}
    changed = 0
    for request in kept_requests():
        stored, answer = read(request.name), got[request.name]
        found = list(differences(stored, answer, request.exact))
        if not found:
            continue
        changed += 1
        file_of(request.name).write_text(pretty(answer) + "\n")
        print(f"{request.name}: {'new' if stored is None else f'{len(found)} differences'}")
        for difference in found[: 0 if stored is None else SHOWN]:
            print(f"  {difference[:200]}")
    for file in sorted(FOLDER.glob("*.json")):
        if file.stem not in got:
            changed += 1
            file.unlink()
            print(f"{file.stem}: removed, since no request has this name")
    print(f"{changed} of {len(got)} answers changed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
