"""`omnirange cache`: the renders and the compiled code that are kept between runs."""

from argparse import Namespace

from harness.cli.options import Commands


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "cache",
        run,
        brief="show or empty the caches of renders and compiled code",
        description="Show where renders and compiled code are stored between runs, and their size. "
        "OMNIRANGE_CACHE says where renders go, OMNIRANGE_CACHE_LIMIT_MB how many megabytes. Compiled code goes to "
        "NUMBA_CACHE_DIR if that is set, else to the user's cache folder.",
    )
    command.add_argument("--clear", action="store_true", help="remove them all")


def run(options: Namespace) -> None:
    """Empty the caches if asked to, and print their contents."""
    from harness import compiled
    from harness.pipeline.render_cache import RenderCache

    cache = RenderCache()
    if options.clear:
        cache.clear()
        compiled.clear()
    contents = cache.contents()
    print(
        f"{cache.folder or 'no home folder'}: {contents.files} renders, "
        f"{contents.bytes / 2**20:.1f} MB of at most {cache.limit / 2**20:.0f} MB"
    )
    folder, versions, size = compiled.contents()
    print(f"{folder or 'nowhere'}: compiled code of {versions} versions of the program, {size / 2**20:.1f} MB")
