"""From YAML to a model: plugin contract, registry, bundles, assembly, tuning."""
