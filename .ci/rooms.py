#!/usr/bin/env python3
"""Prints how the rooms and files of both crates depend on each other, and the lengths of the core's functions.

A room is a folder or file directly below `src`. A file uses what its `use` declarations and paths name within the crate,
outside `#[cfg(test)]` items. A name that a module re-exports leads to the file that defines it. A door is a file of
nothing but module declarations and re-exports; it uses nothing. Binaries are left out.
Exits with 1 and the names if files or rooms depend on each other in a circle.
"""

import re
import sys
from pathlib import Path

CRATES = ["src", "host-tests/src"]
DECLARATION = r"(?:pub(?:\([^)]*\))?\s+)?(?:use\s+[^;]+|mod\s+\w+|extern\s+crate\s+\w+)\s*;"
ITEM = r"\b(?:struct|enum|trait|type|fn|const|static|union|mod|macro_rules!)\s+(?:mut\s+)?(\w+)"


def end_of_item(code, start):
    """The end of the item that begins at `start`: after its semicolon or its closing brace."""
    depth = 0
    for position in range(start, len(code)):
        depth += {"{": 1, "(": 1, "[": 1, "}": -1, ")": -1, "]": -1}.get(code[position], 0)
        if depth == 0 and code[position] in ";}":
            return position + 1
    return len(code)


def code_of(path, tests):
    """The code of a file without comments and the contents of strings; without `#[cfg(test)]` items unless `tests`."""
    tokens = r'//[^\n]*|/\*.*?\*/|b?r(#*)".*?"\1|"(?:\\.|[^"\\])*"|\'(?:\\.[^\']*|[^\'\\])\''
    blank = lambda found: '""' if found[0][0] in "\"'rb" else ""
    code = re.sub(tokens, blank, path.read_text(), flags=re.S)
    while not tests and (found := re.search(r"#\[cfg\((?:all\()?test\b[^\]]*\]", code)):
        code = code[: found.start()] + code[end_of_item(code, found.end()) :]
    return code


def paths_of(tree):
    """The paths of a `use` tree: `a::{b, c::{d, e}}` gives a::b, a::c::d and a::c::e."""
    found = re.match(r"([^{]*)\{(.*)\}$", tree, re.S)
    if not found:
        return [re.split(r"\sas\s", tree)[0].strip()]
    parts, depth = [""], 0
    for letter in found[2]:
        depth += {"{": 1, "}": -1}.get(letter, 0)
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return [path for part in parts if part.strip() for path in paths_of(found[1].strip() + part.strip())]


class Crate:
    def __init__(self, root, tests=False):
        files = [path for path in sorted(Path(root).rglob("*.rs")) if "bin" not in path.relative_to(root).parts]
        self.code = {self.module(path.relative_to(root)): code_of(path, tests) for path in files}
        rest = lambda code: re.sub(r"#!?\[[^\]]*\]|\s", "", re.sub(DECLARATION, "", code))
        self.doors = {name for name, code in self.code.items() if not rest(code)}
        self.uses = {name: set() for name in self.code}
        self.room_uses = {self.room(name): set() for name in self.code if name}
        for name in self.code:
            if name not in self.doors:
                self.find_uses(name)

    @staticmethod
    def module(path):
        parts = path.with_suffix("").parts
        return parts[:-1] if parts[-1] in ("mod", "lib") else parts

    @staticmethod
    def room(name):
        return name[0]

    def find_uses(self, name):
        code = self.code[name]
        trees = re.findall(r"\buse\s+([^;]+);", code)
        inline = re.findall(r"(?<![\w:])\w+(?:::\w+)+", re.sub(r"\buse\s[^;]+;", "", code))
        for path in [path for tree in trees for path in paths_of(tree)] + inline:
            head = path.split("::")[0]
            if head not in ("crate", "self", "super"):
                if (*name, head) not in self.code:
                    continue
                path = "self::" + path
            target = self.resolve(name, path)
            if target is not None and target != name:
                self.uses[name].add(target)
                if name and target and self.room(target) != self.room(name):
                    self.room_uses[self.room(name)].add(self.room(target))

    def resolve(self, name, path, seen=()):
        """The file that a path names from within the module `name`."""
        head, *rest = path.split("::")
        while head == "super":
            name, head, rest = name[:-1], rest[0] if rest else "", rest[1:]
            if head != "super":
                head, rest = "self", [head] * bool(head) + rest
        at = name if head == "self" else ()
        while rest and at + (rest[0],) in self.code:
            at, rest = at + (rest[0],), rest[1:]
        if at not in self.code or at in seen:
            return None
        return self.re_exported(at, rest[0], seen) if rest and rest[0] not in ("self", "*") else at

    def re_exported(self, at, item, seen):
        if item in re.findall(ITEM, self.code[at]):
            return at
        for tree in re.findall(r"\bpub(?:\([^)]*\))?\s+use\s+([^;]+);", self.code[at]):
            for path in paths_of(tree):
                *parents, last = path.split("::")
                if last not in (item, "*"):
                    continue
                if parents and parents[0] not in ("crate", "self", "super"):
                    parents = ["self", *parents]
                target = self.resolve(at, "::".join([*parents, item]), (*seen, at))
                if target is not None and (last == item or item in re.findall(ITEM, self.code[target])):
                    return target
        return at


def reached(uses, start):
    """All that depends on, `start` itself only if it is in a circle."""
    found, new = set(), set(uses[start])
    while new:
        found |= new
        new = {target for name in new for target in uses[name]} - found
    return found


def circles(uses):
    """Groups of names each of which depends on all others of its group."""
    below = {name: reached(uses, name) for name in uses}
    groups = {tuple(sorted(x for x in below[name] if name in below[x])) for name in uses if name in below[name]}
    return sorted(groups)


def floors(uses):
    """Length of the longest chain of dependences; a circle is one floor."""
    group = {name: name for name in uses} | {name: circle for circle in circles(uses) for name in circle}
    height = {}

    def floor(of):
        if of not in height:
            below = {group[target] for name in uses if group[name] == of for target in uses[name]} - {of}
            height[of] = 1 + max(map(floor, below), default=0)
        return height[of]

    return max(map(floor, group.values()), default=0)


def function_lengths(crate):
    """Lines of each function that has a body, from `fn` to the closing brace."""
    lengths = []
    for name, code in crate.code.items():
        for found in re.finditer(r"\bfn\s+(\w+)", code):
            text = code[found.start() : end_of_item(code, found.start())]
            if text.endswith("}"):
                lengths.append((sum(1 for line in text.split("\n") if line.strip()), "::".join((*name, found[1]))))
    return sorted(lengths)


def arrows(crate):
    """Pairs of a room and another room that it names, and pairs of a file and another room that it names."""
    by_files = {(name, crate.room(to)) for name, uses in crate.uses.items() if name for to in uses if to}
    by_files = {(name, room) for name, room in by_files if room != crate.room(name)}
    return len({(crate.room(name), room) for name, room in by_files}), len(by_files)


def main():
    failed = False
    for root in CRATES:
        crate = Crate(root)
        by_rooms, by_files = arrows(crate)
        print(f"{root}: {len(crate.room_uses)} rooms, {len(crate.code)} files, {floors(crate.room_uses)} floors")
        print(f"{root}: {by_rooms} arrows from a room to a room, {by_files} from a file to a room;"
              " %d and %d with those of tests" % arrows(Crate(root, tests=True)))
        for what, found in [("files", circles(crate.uses)), ("rooms", circles(crate.room_uses))]:
            for circle in found:
                failed = True
                names = ["::".join(name) if isinstance(name, tuple) else name for name in circle]
                print(f"{root}: circle of {what}: {', '.join(names)}")
    lengths = function_lengths(Crate(CRATES[0]))
    at = lambda part: lengths[int(part * (len(lengths) - 1))][0]
    print(f"{CRATES[0]}: {len(lengths)} functions, median {at(0.5)} lines, 90 % up to {at(0.9)}, "
          f"longest {lengths[-1][0]} ({lengths[-1][1]})")
    return failed


if __name__ == "__main__":
    sys.exit(main())
