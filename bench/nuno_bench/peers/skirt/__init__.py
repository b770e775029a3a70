"""The skirt on a dancer, in other engines and in ours."""
