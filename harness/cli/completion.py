"""`omnirange completion`: a script for shell completion of commands, options and names."""

from argparse import Namespace

from harness.cli.options import Commands

SHELLS = ("bash", "zsh", "fish")


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "completion",
        run,
        brief="print a script for shell completion",
        description="Print a script with which a shell completes commands, options, the names of experiments and "
        "scenes, kinds of matcher, and keys.",
        epilog='bash: eval "$(omnirange completion bash)" in ~/.bashrc; '
        "zsh: the same with zsh in ~/.zshrc, after compinit; "
        "fish: omnirange completion fish > ~/.config/fish/completions/omnirange.fish",
    )
    command.add_argument("shell", choices=SHELLS, help="the shell")


def run(options: Namespace) -> None:
    """Print the script."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["omnirange"], shell=options.shell))
