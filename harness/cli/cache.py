"""`omnirange cache`: the renders that are kept between runs."""

from argparse import Namespace

from harness.cli.options import Commands


def add(commands: Commands) -> None:
    """Declare the sub-command."""
    command = commands.add(
        "cache",
        run,
        brief="show or empty the cache of renders",
        description="Show where renders are kept between runs and how large they are. OMNIRANGE_CACHE says where, "
        "OMNIRANGE_CACHE_LIMIT_MB how much.",
    )
    command.add_argument("--clear", action="store_true", help="remove them all")


def run(options: Namespace) -> None:
    """Empty the cache if asked to, and say what it holds."""
    from harness.pipeline.render_cache import RenderCache

    cache = RenderCache()
    if options.clear:
        cache.clear()
    contents = cache.contents()
    print(
        f"{cache.folder}: {contents.files} renders, "
        f"{contents.bytes / 2**20:.1f} MB of at most {cache.limit / 2**20:.0f} MB"
    )
