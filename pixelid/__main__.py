from pixelid.cli.main import run

run()
