"""Spectral imagers: SSCSI, CASSI, dual-disperser and colored CASSI."""
