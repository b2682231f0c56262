"""Arms as the package reads them, for tests; the simulators beside do without the
package.
"""
