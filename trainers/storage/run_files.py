"""Names of what lies in a run's directory; light to import."""

CONFIG_FILE = "config.yaml"
CHECKPOINTS = "checkpoints"
VIDEOS = "videos"
METRICS = "metrics.csv"
RESULTS = "results.json"
VERSIONS = "versions.json"
REPORT = "report.html"
