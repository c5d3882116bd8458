"""What a journal holds of the studies: records, figures, claims, and a table of all claims."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from .journal import Journal
from .source import SceneSource, generated
from .study import Claim, Record, Study
from .tasks import make_tasks, one_line


@dataclass(frozen=True, kw_only=True, eq=False)
class Holding:
    """What a journal holds of a study with one scene.

    Attributes
    ----------
    scene, quick : which of its records.
    records, total : how many there are, and how many it needs.
    claims : what they show; empty as long as records are missing.
    problem : why there are no claims although no record is missing; empty if there are.
    """

    scene: SceneSource
    quick: bool
    records: int
    total: int
    claims: tuple[Claim, ...]
    problem: str = ""

    @property
    def complete(self) -> bool:
        """Whether no record is missing, and claims could be made of them."""
        return self.records == self.total and not self.problem

    @property
    def label(self) -> str:
        """Name of the scene, and whether the study was cut short."""
        return f"{self.scene.name}, quick" if self.quick else self.scene.name


def gather(study: Study, scene: SceneSource, quick: bool, journal: Journal) -> list[Record]:
    """Records of a study, in the order of its specifications.

    Raises
    ------
    ValueError
        If records are missing; it says how many, and the first error if tasks failed.
    """
    keys = [task.key for task in make_tasks(study, scene, quick)]
    found = journal.records(keys)
    if len(found) < len(set(keys)):
        failures = journal.failures(set(keys) - set(found))
        failed = f" ({len(failures)} failed: {next(iter(failures.values())).splitlines()[-1]})" if failures else ""
        raise ValueError(
            f"{journal.path} has {len(found)} of the {len(set(keys))} records of {study.name} on {scene.name}{failed};"
            f" run '{run_command(study, scene, quick, journal)}'"
        )
    return [found[key] for key in keys]


def run_command(study: Study, scene: SceneSource, quick: bool, journal: Journal) -> str:
    """The command that computes what is missing."""
    chosen = "" if scene.path is None else f" --scene {scene.path}"
    return f"shadowgram study run {study.name}{' --quick' if quick else ''}{chosen} --out {journal.path.parent}"


def figure_name(study: Study, scene: SceneSource, quick: bool) -> str:
    """File name of a figure; the generated scene goes without saying.

    Examples
    --------
    >>> from shadowgram.experiments.holdings import figure_name
    >>> from shadowgram.experiments.source import generated
    >>> from shadowgram.experiments.studies import load
    >>> figure_name(load("fig-2-15"), generated(), quick=True)
    'fig-2-15-quick.png'
    """
    return f"{study.name}{'' if scene.path is None else f'-{scene.name}'}{'-quick' if quick else ''}.png"


def figure_png(study: Study, records: Sequence[Record], dpi: float = 160) -> bytes:
    """Figure of a study as a PNG file; the same records give the same bytes."""
    from shadowgram.figures.style import png, style

    with style():
        return png(study.figure(records), dpi=dpi)


def holdings(study: Study, journal: Journal) -> list[Holding]:
    """What there is of a study, scene by scene; nothing that there are no records of."""
    found = []
    for scene in told_apart(journal.scenes(study.name, study.revision)):
        full = _holding(study, scene, False, journal)
        quick = _holding(study, scene, True, journal)
        # The full form may share tasks with the quick one, of which nobody asked for the rest.
        found += [one for one in (full, quick) if one.complete or (one.records and not (one is quick and full.records))]
    return found


def told_apart(scenes: Sequence[SceneSource]) -> list[SceneSource]:
    """Scenes with the digest behind the name of those that share it, which happens when a file has been made again."""
    names = [scene.name for scene in scenes]
    return [
        replace(scene, name=f"{scene.name}-{scene.digest[:6]}") if names.count(scene.name) > 1 else scene
        for scene in scenes
    ]


def find_scene(study: Study, name: str | None, journal: Journal) -> SceneSource:
    """Scene of this name, or with this digest, that a journal has records of; without a name the generated one.

    Raises
    ------
    ValueError
        If there is none.
    """
    if name is None:
        return generated()
    scenes = told_apart(journal.scenes(study.name, study.revision))
    for scene in scenes:
        if name in {scene.name, scene.digest}:
            return scene
    there = ", ".join(scene.name for scene in scenes) or "none"
    raise ValueError(f"{journal.path} has no records of {study.name} on {name!r}; scenes it has: {there}")


def agreement(claims: Sequence[Claim]) -> str:
    """How many claims agree, in words.

    Examples
    --------
    >>> from shadowgram.experiments.holdings import agreement
    >>> from shadowgram.experiments.study import Claim
    >>> agreement([Claim(page=40, says="a", found="a", agrees=True), Claim(page=41, says="b", found="c", agrees=None)])
    'agrees 1 of 2, 1 open'
    """
    stated = [claim.agrees for claim in claims if claim.page is not None]
    still_open = stated.count(None)
    return f"agrees {stated.count(True)} of {len(stated)}" + (f", {still_open} open" if still_open else "")


def verdict(claim: Claim) -> str:
    """Whether a claim agrees, in a word; of a question of ours it cannot be said."""
    if claim.page is None:
        return "–"
    return {True: "yes", False: "no", None: "open"}[claim.agrees]


def page(
    studies: Sequence[tuple[Study, Sequence[Holding]]], command: str
) -> tuple[str, dict[str, tuple[Study, Holding]]]:
    """Page in Markdown: a table of all claims of the source, then every study with its figure and what was found on every scene.

    Of a scene with all records of a study those cut short are left out.

    Parameters
    ----------
    studies : with what the journal holds of them.
    command : that writes the page again.

    Returns
    -------
    (text, figures)
        The page, and the figures that it shows from its own folder: file name → what is drawn.
    """
    shown = [(study, _shown(held)) for study, held in studies]
    labels = list(dict.fromkeys(holding.label for _, held in shown for holding in held))
    rows: list[str] = []
    figures: dict[str, tuple[Study, Holding]] = {}
    details: list[str] = []
    for study, held in shown:
        if not held:
            continue
        name = figure_name(study, held[0].scene, held[0].quick)
        figures[name] = (study, held[0])
        details += ["", f"## {study.name}: {study.title}", "", f"{study.source}.", "", f"![{study.title}]({name})"]
        for (page, says), found in _statements(held).items():
            details += ["", f"**{place(page)}: {says}{'' if says.endswith('?') else '.'}**", ""]
            if page is None:
                details += [f"- {label}: {_sentence(one)}" for label, one in found.items()]
                continue
            verdicts = [verdict(found[label]) if label in found else "" for label in labels]
            rows.append(_row([f"[{study.name}](#{_anchor(study)})", str(page), says, *verdicts]))
            details += [f"- {label}: {verdict(one)}. {_sentence(one)}" for label, one in found.items()]
    opening = _opening(labels, rows, command)
    return "\n".join([*opening, *details]) + "\n", figures


def _opening(labels: Sequence[str], rows: Sequence[str], command: str) -> list[str]:
    """Title and table of the source's claims; without a table where there is none."""
    made = f"Computed by `shadowgram study run`, with `--scene FILE` for recorded scenes; written by `{command}`."
    if not rows:
        return ["# What was found", "", made]
    return [
        "# What the source says, and what was found",
        "",
        made,
        "The pages are those of E. E. Salazar, *Code aperture imaging from the visible to X-ray*, University of Delaware, 2022.",
        "Empty cells: the study does not use a scene, and was run once. Further down, every study with its figure, the numbers,",
        "and questions that the source does not ask.",
        "",
        _row(["study", "page", "the source says", *labels]),
        _row(["---"] * (3 + len(labels))),
        *rows,
    ]


def _statements(held: Sequence[Holding]) -> dict[tuple[int | None, str], dict[str, Claim]]:
    """Page and statement → label of the scene → claim."""
    found: dict[tuple[int | None, str], dict[str, Claim]] = {}
    for holding in held:
        for claim in holding.claims:
            found.setdefault((claim.page, claim.says), {})[holding.label] = claim
    return found


def place(page: int | None) -> str:
    """Where a claim stands."""
    return "Beyond the source" if page is None else f"Page {page}"


def _anchor(study: Study) -> str:
    """Anchor that Markdown makes of a study's heading."""
    kept = [c for c in f"{study.name}: {study.title}".lower() if c.isalnum() or c in " -"]
    return "".join(kept).replace(" ", "-")


def _sentence(claim: Claim) -> str:
    why = f" Why: {claim.why}." if claim.why else ""
    return " ".join(f"{claim.found}.{why}".split())


def _shown(held: Sequence[Holding]) -> list[Holding]:
    whole = {holding.scene.digest for holding in held if holding.complete and not holding.quick}
    return [one for one in held if one.complete and not (one.quick and one.scene.digest in whole)]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells) + " |"


def _holding(study: Study, scene: SceneSource, quick: bool, journal: Journal) -> Holding:
    keys = list(dict.fromkeys(task.key for task in make_tasks(study, scene, quick)))
    there = sum(journal.seconds(key) is not None for key in keys)
    claims, problem = (), ""
    if there == len(keys):
        try:
            claims = tuple(study.claims(gather(study, scene, quick, journal)))
        except Exception as error:  # noqa: BLE001 - the other studies of the list must not suffer
            problem = one_line(error)
    return Holding(scene=scene, quick=quick, records=there, total=len(keys), claims=claims, problem=problem)
