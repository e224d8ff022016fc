"""Constitutive laws: phase fractions, strain and resistivity of a material point."""
