"""`formal/run.sh` fails if a proof at reduced width has no companion at full width; and all proofs
have theirs."""

import shutil
import subprocess
import tempfile
from pathlib import Path

FORMAL = Path(__file__).resolve().parents[1] / "formal"


def run(folder, lines):
    """The output of run.sh for these proofs, without any tool: (exit code, text)."""
    (folder / "formal" / "core.proofs").write_text("\n".join(["# NAME TOP DEPTH MODE WIDTH MUTATION", "rtl core.sv", *lines, ""]))
    done = subprocess.run(["bash", str(folder / "formal" / "run.sh"), "core"], env={"PATH": "/usr/bin:/bin"}, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout


def main():
    reduced, full = "holds top 2:6 induction N=1 s/a/b/", "holds top 2:6 bounded full s/a/b/"
    lonely = "core holds (top, N=1): has no companion at full width"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "formal").mkdir()
        shutil.copyfile(FORMAL / "run.sh", folder / "formal" / "run.sh")
        for others in ([], ["else top 2:6 bounded full s/a/b/"], ["holds other 2:6 bounded full s/a/b/"], ["holds top 2:6 bounded N=2 s/a/b/"]):
            code, said = run(folder, [reduced, *others])
            assert code == 1 and lonely in said, (others, code, said)
        (folder / "rtl").mkdir()
        source, whole = folder / "rtl" / "core.sv", full.replace("holds", "all")
        for text in ("", "`ifdef PROVE_all\n`define PROVE_holds_more\n`endif\n`define PROVE_holds\n", "`ifdef PROVE_most\n`define PROVE_holds\n`endif\n"):
            source.write_text(text)
            code, said = run(folder, [reduced, whole])
            assert code == 1 and lonely in said, (text, code, said)
        source.write_text("`ifdef PROVE_all\n`define PROVE_holds\n`endif\n")
        for proofs in ([reduced, whole], [reduced, full], [full, reduced, reduced], [full]):
            code, said = run(folder, proofs)
            assert "companion" not in said and "no z3" in said, (proofs, said)
    print("PASS proofs: one at reduced width without a companion at full width stops them all")


if __name__ == "__main__":
    main()
